"""What all types of `custom` checks share: period, slot, needs, level, text for the operator, recovery."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._readiness import BUSY
from phm_checks._text import brief, clean

DEADLINE_MARGIN_S = 5.0
"""The probe ends at the entry's `timeout`; the run is overdue only if the probe does not."""
FAILED = "custom_failed"
RENEW_S = 60.0
"""A line for the operator of which only numbers change is renewed this often: the ground receives each change."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass(frozen=True)
class Finding:
    """What one run found. level: OK, WARN, or ERROR, which becomes the level of the entry.

    text: a clause for the log, e.g. `port 80 of camera refused the connection`. short: the same in two or three words.
    unanswered: only an answer is missing, which a busy node gives late, so that recovery restarts nothing.
    """

    level: Level
    text: str
    short: str = ""
    values: Mapping[str, api.Value] = field(default_factory=dict)
    evidence: api.Evidence = field(default_factory=api.Evidence)
    unanswered: bool = False


def good(text: str, **values: api.Value) -> Finding:
    return Finding(Level.OK, text, values=values)


def bad(text: str, short: str, **values: api.Value) -> Finding:
    return Finding(Level.ERROR, text, short, values)


class CustomCheck(api.Check):
    """Base of the types. A type overrides `observe`, and `container` if it concerns one.

    `observe` returns what it found, or raises CannotTell. Text from outside may be passed on unchanged: it is cleaned here.
    """

    name, slot, layer = "custom", Slot.USER_1, Layer.CUSTOM

    def __init__(self, entry: Any, settings: api.Settings) -> None:
        self.entry, self.settings = entry, settings
        self.slot = Slot(entry.slot)
        self.period_s, self.failures = entry.period, entry.failures
        self.deadline_s = entry.timeout + DEADLINE_MARGIN_S
        self._shown: tuple[Level, str, float] = (Level.OK, "", 0.0)
        """Level and line for the operator, and since when (monotonic seconds)."""

    @property
    def container(self) -> str:
        """Key of the container that it concerns; empty: none."""
        return getattr(self.entry, "container", None) or ""

    @property
    def subject(self) -> str:
        return str(self.entry.name)

    @property
    def units(self) -> Sequence[api.Unit]:
        target = self._acts_on or self.container
        needs = tuple(f"container/{key}" for key in dict.fromkeys((target, self.container)) if key)
        return (api.Unit(f"{self.name}/{self.subject}", (*needs, *self.entry.needs), target, grace_s=self.entry.grace),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset(f"container:{key}" for key in {self._acts_on, self.container} if key)

    @abstractmethod
    def observe(self, world: api.World) -> Finding:
        """Ask the probe once and judge the answer."""

    def run(self, world: api.World) -> api.Result:
        try:
            found = self.observe(world)
        except api.CannotTell as reason:
            raise api.CannotTell(clean(str(reason), 300)) from reason
        text = f"{self.subject}: {clean(found.text, 300)}"
        if found.level is Level.OK:
            self._shown = (Level.OK, "", 0.0)
            return api.ok(text, values=found.values).with_evidence(found.evidence)
        level = Level.WARN if self.entry.level == "warn" else found.level
        words = f"{text}. {clean(self.entry.advice)}" if self.entry.advice else text
        target = "" if found.unanswered else self._acts_on
        if target != self._acts_on:
            words = f"{words}. {BUSY}"
        short = brief(self.entry.brief or brief(self.subject, found.short))
        line = self._steady(level, short, world.clock.mono())
        return api.Result(level, words, line, FAILED, target, found.values, evidence=found.evidence)

    def _steady(self, level: Level, line: str, now_s: float) -> str:
        """The line that is shown already, if the new one differs in numbers alone."""
        before, shown, since_s = self._shown
        same = before is level and _NUMBER.sub("", shown) == _NUMBER.sub("", line)
        if not same or now_s - since_s >= RENEW_S:
            self._shown = (level, line, now_s)
        return self._shown[1]

    @property
    def _acts_on(self) -> str:
        """The container that recovery may act on; empty: it may not."""
        return self.entry.recovery.container if self.entry.recovery is not None else ""
