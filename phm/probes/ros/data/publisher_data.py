"""The examined messages of one publisher, and which limits they exceed. Pure: callers pass times."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from phm.facts.ros import DataFact, FieldFact, OutsideFact
from phm.probes.ros.protocol import WantedData

KEPT = 10
"""This many of the newest messages count for order, ranges and gaps."""
CONFIRM_S = 1.0
"""Stamps must be wrong, or right again, in two messages this far apart: one late message is not a wrong clock."""
TWICE = 2
"""A range is exceeded when this many of the newest messages exceed it."""
LOSSES = 3
"""Gaps count when this many of the newest intervals have one: a source that was restarted makes one."""
STAY = 0.7
"""Hysteresis: a condition ends only below this share of its limit."""
REPEATS = 2


@dataclass(frozen=True, slots=True)
class Examined:
    """One message. at_s: when it was taken, monotonic. age_s: reception minus stamp; None: there is no stamp. stamp_ns: likewise.

    sequence: number of the publication; None if the middleware has none. counter: value of the configured field.
    outside: fields with a value outside of their range, with that value as text. fields: those whose value is reported.
    """

    at_s: float
    sequence: int | None = None
    stamp_ns: int | None = None
    age_s: float | None = None
    content: bytes | None = None
    counter: float | None = None
    outside: Mapping[str, str] = field(default_factory=dict)
    fields: tuple[FieldFact, ...] = ()


class PublisherData:
    """counter_bits: of an integer counter, which wraps; None for a floating-point one."""

    def __init__(self, wanted: WantedData, counter_bits: int | None = None) -> None:
        self._wanted = wanted
        self._modulus = 2**counter_bits if counter_bits else None
        self._begin()

    def _begin(self) -> None:
        self.last: Examined | None = None
        self._first_same: Examined | None = None
        self._repeats = 0
        self._changed = False
        self._stamps = _Lasting()
        self._wrong_stamp = False
        self._age_s: float | None = None
        """Of the newest message, or of the newest with a wrong stamp while that is reported."""
        self._backs: deque[float] = deque(maxlen=KEPT)
        self._outside: deque[Mapping[str, str]] = deque(maxlen=KEPT)
        self._losses: deque[tuple[float, float]] = deque(maxlen=KEPT)
        """(Share of the numbers that are missing, seconds) of each interval between two messages."""
        self._lossy = False
        self._intervals = 0

    def add(self, message: Examined) -> None:
        """Count one message. A lower sequence number is a restarted publisher, and nothing before counts."""
        last = self.last
        if last is not None and last.sequence is not None and message.sequence is not None:
            if message.sequence == last.sequence:
                return
            if message.sequence < last.sequence:
                self._begin()
                last = None
        self._add_stamp(last, message)
        self._add_content(message)
        self._outside.append(message.outside)
        if last is not None:
            self._add_counter(last, message)
        self.last = message

    def fact(self) -> DataFact:
        """Without `samples` and `problem`, which are the topic's."""
        age_s = self._age_s
        backs = [step_s for step_s in self._backs if step_s > 0.0]
        lost_percent = self._lost_percent
        named = {
            "data_stamp": self._stamps.bad,
            "data_order": self._wanted.order and bool(backs),
            "data_frozen": self._frozen,
            "data_range": sum(map(bool, self._outside)) >= TWICE,
            "data_gaps": self._lossy,
        }
        decided = {
            "data_stamp": self._stamps.decided,
            "data_frozen": self._wanted.frozen_s is None or self._frozen or self._changed,
            "data_gaps": not self._wanted.counter or self._intervals >= LOSSES,
        }
        return DataFact(
            conditions=tuple(name for name, exceeded in named.items() if exceeded),
            age_s=None if age_s is None else round(age_s, 3),
            unset=self.last is not None and self.last.stamp_ns == 0,
            backs=len(backs),
            back_s=round(max(backs, default=0.0), 6),
            frozen_s=round(self._frozen_s, 3),
            lost_percent=None if lost_percent is None else round(lost_percent, 2),
            outside=self._newest_outside(),
            fields=() if self.last is None else self.last.fields,
            undecided=tuple(name for name, known in decided.items() if not known),
        )

    # ---- stamps

    def _add_stamp(self, last: Examined | None, message: Examined) -> None:
        back_from_wrong = self._wrong_stamp
        limit_s = self._wanted.max_age_s
        if limit_s is not None and message.age_s is not None:
            self._wrong_stamp = abs(message.age_s) > limit_s * (STAY if self._stamps.bad else 1.0)
            self._stamps.add(message.at_s, bad=self._wrong_stamp)
            if self._wrong_stamp or not self._stamps.bad:
                self._age_s = message.age_s
        if last is not None and last.stamp_ns is not None and message.stamp_ns is not None:
            step_s = (last.stamp_ns - message.stamp_ns) / 1e9
            # The return of a wrong clock is the end of one condition, not the begin of another.
            self._backs.append(0.0 if back_from_wrong else step_s)

    # ---- content

    def _add_content(self, message: Examined) -> None:
        first = self._first_same
        if first is None or message.content is None or message.content != first.content:
            self._changed = first is not None
            self._first_same, self._repeats = message, 0
        else:
            self._repeats += 1

    @property
    def repeats(self) -> bool:
        """Whether the newest message has the content of the one before."""
        return self._repeats > 0

    @property
    def _frozen_s(self) -> float:
        if self.last is None or self._first_same is None:
            return 0.0
        return self.last.at_s - self._first_same.at_s

    @property
    def _frozen(self) -> bool:
        limit_s = self._wanted.frozen_s
        return limit_s is not None and self._repeats >= REPEATS and self._frozen_s >= limit_s

    # ---- counter

    def _add_counter(self, last: Examined, message: Examined) -> None:
        """Compare the steps of the counter with those of the publications. A counter that goes back was reset."""
        if last.counter is None or message.counter is None or last.sequence is None or message.sequence is None:
            return
        published = message.sequence - last.sequence
        lost = message.counter - last.counter - published
        if not math.isfinite(lost):
            return
        if self._modulus is not None:
            half = self._modulus // 2
            lost = (lost + half) % self._modulus - half
        if lost < 0:
            self._losses.clear()
        else:
            self._losses.append((lost / (lost + published), message.at_s - last.at_s))
        self._intervals += 1
        self._judge_losses()

    def _judge_losses(self) -> None:
        lossy = sum(share > 0.0 for share, _ in self._losses)
        limit = self._wanted.gaps_percent * (STAY if self._lossy else 1.0)
        self._lossy = lossy >= LOSSES and (self._lost_percent or 0.0) > limit

    @property
    def _lost_percent(self) -> float | None:
        """Mean over time, not over numbers: a single large step, e.g. of a restarted source, is one short interval."""
        seconds = sum(span_s for _, span_s in self._losses)
        return 100 * sum(share * span_s for share, span_s in self._losses) / seconds if seconds else None

    # ---- ranges

    def _newest_outside(self) -> tuple[OutsideFact, ...]:
        found: dict[str, str] = {}
        for fields in self._outside:
            found.update(fields)
        return tuple(OutsideFact(name, value) for name, value in found.items())


class _Lasting:
    """A state that changes when two messages, CONFIRM_S apart, and all between them, show the other one."""

    def __init__(self) -> None:
        self.bad = False
        self.decided = True
        """Once something was added: whether it has had the time to become bad."""
        self._first_s: float | None = None
        self._since_s: float | None = None

    def add(self, at_s: float, *, bad: bool) -> None:
        if self._first_s is None:
            self._first_s, self.decided = at_s, False
        self._add(at_s, bad=bad)
        self.decided = self.decided or (self._since_s is None and at_s - self._first_s >= CONFIRM_S)

    def _add(self, at_s: float, *, bad: bool) -> None:
        if bad == self.bad:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = at_s
        elif at_s - self._since_s >= CONFIRM_S:
            self.bad, self._since_s = bad, None
