"""Examines a few of one topic's messages per second, those that its rate's reader takes anyway."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from phm.core.message_fields import has_header
from phm.facts.ros import DataFact, FieldFact
from phm.probes.ros.data.decoder import Decoder, Undecodable
from phm.probes.ros.data.publisher_data import Examined, PublisherData
from phm.probes.ros.data.raw_message import NoHeader, digest, stamp_ns
from phm.probes.ros.protocol import WantedData
from phm.probes.ros.reader import RawMessage

MOST = 8
"""Publishers that are examined; further ones are ignored."""
GONE_S, GONE_PERIODS = 3.0, 3.0
"""A publisher that is silent for longer while another is not does not count any more."""
EARLY_S = 0.05
"""Looks are a little irregular: a message may be examined so much before its time."""
EARLIEST_STAMP_NS = 946_684_800 * 10**9
"""The year 2000. An earlier stamp at the beginning of an unknown type may be two numbers of another meaning."""
_NO_SEQUENCE = "gaps cannot be measured: this middleware gives no sequence numbers"
_MIXED = "order and gaps cannot be examined: the publishers of this topic cannot be distinguished"


class DataMonitor:
    """For one topic; messages never cause an exception. `pause_s`: the longest time between two messages that are taken."""

    def __init__(
        self,
        wanted: WantedData,
        rate_hz: float,
        decoder: Callable[[WantedData, str], Decoder] = Decoder,
        begins_with_header: Callable[[str], bool | None] = has_header,
    ) -> None:
        self._wanted = wanted
        self._gone_s = max(GONE_S, GONE_PERIODS / rate_hz if rate_hz else 0.0)
        self._make_decoder, self._begins_with_header = decoder, begins_with_header
        self._type = ""
        self._decoder: Decoder | None = None
        self._header: bool | None = None
        self._problem = ""
        """The problem of the newest message, else empty."""
        self._publishers: dict[bytes | None, PublisherData] = {}
        self._repeated = False
        """Two messages of this type were equal, so they have no stamp that would hide frozen content."""
        self._next_s = float("-inf")
        self._samples = 0
        self.fact: DataFact | None = None
        """All publishers together: the worst of each number. None until a message was examined."""

    def update(
        self, now_s: float, type_name: str, taken: Sequence[RawMessage], *, pause_s: float = 0.0, mixed: bool = False
    ) -> None:
        """The messages since the last poll, oldest first. mixed: they may be of several publishers."""
        if not taken or now_s < self._next_s - EARLY_S:
            return
        if type_name != self._type:
            self._begin(type_name)
        self._next_s = max(self._next_s, now_s - EARLY_S) + 1 / self._wanted.hz
        self._problem = ""
        newest = {message.writer: message for message in taken}
        for writer, message in newest.items():
            self._examine(now_s, message, mixed=mixed and writer is None)
        for writer, publisher in list(self._publishers.items()):
            if publisher.last is None or now_s - publisher.last.at_s > self._gone_s + pause_s:
                del self._publishers[writer]
        self.fact = self._together()

    def _together(self) -> DataFact:
        facts = [publisher.fact() for publisher in self._publishers.values()]
        return replace(worst_of(facts), samples=self._samples, problem=self._permanent() or self._problem)

    def _begin(self, type_name: str) -> None:
        self._type, self._repeated = type_name, False
        self._publishers.clear()
        self._decoder = self._make_decoder(self._wanted, type_name)
        needed = self._wanted.header or self._wanted.frozen_s is not None
        self._header = self._begins_with_header(type_name) if needed else False

    def _permanent(self) -> str:
        """A problem that every message of this type has."""
        if self._wanted.header and self._header is False:
            return f"{self._type} does not begin with a std_msgs/Header, so it has no stamp"
        return self._decoder.problem if self._decoder is not None else ""

    def _examine(self, now_s: float, message: RawMessage, *, mixed: bool) -> None:
        publisher = self._publishers.get(message.writer)
        if publisher is None:
            if len(self._publishers) >= MOST:
                return
            assert self._decoder is not None
            publisher = self._publishers[message.writer] = PublisherData(self._wanted, self._decoder.counter_bits)
        examined = self._read(now_s, message)
        if mixed:
            examined = replace(examined, sequence=None, stamp_ns=None, counter=None)
            self._problem = self._problem or (_MIXED if self._wanted.order or self._wanted.counter else "")
        self._samples += 1
        publisher.add(examined)
        self._repeated = self._repeated or publisher.repeats

    def _read(self, now_s: float, message: RawMessage) -> Examined:
        assert self._decoder is not None
        data, found = message.data, Examined(now_s, message.sequence)
        header = self._header
        if header is not False:
            try:
                stamp = stamp_ns(data)
                if self._wanted.header:
                    found = replace(found, stamp_ns=stamp, age_s=(message.received_ns - stamp) / 1e9)
                header = header or self._wanted.header or stamp >= EARLIEST_STAMP_NS
            except NoHeader as error:
                header = False
                if self._wanted.header:
                    self._problem = f"a message has no valid header: {error}"
        if not self._decoder.usable:
            found = replace(found, fields=self._decoder.unreadable)
        else:
            try:
                counter, outside, data, fields, problem = self._decoder.read(data)
                found = replace(found, counter=counter, outside=outside, fields=fields)
                self._problem = self._problem or problem
            except Undecodable as error:
                self._problem = str(error)
            if self._wanted.counter and message.sequence is None:
                self._problem = self._problem or _NO_SEQUENCE
        if self._wanted.frozen_s is not None:
            found = replace(found, content=digest(data, header=header))
            if self._decoder.stamped is None and not (header or self._repeated):
                self._problem = self._problem or (
                    f"frozen cannot be judged: the fields of {self._type} are unknown, so it may have a stamp that hides frozen "
                    "content; name the folder with its package in ros.installs"
                )
        return found


def worst_of(facts: Sequence[DataFact]) -> DataFact:
    """One fact of those of all publishers."""
    if len(facts) == 1:
        return facts[0]
    losses = [fact.lost_percent for fact in facts if fact.lost_percent is not None]
    stamped = max(facts, key=lambda fact: abs(fact.age_s or 0.0), default=DataFact())
    return DataFact(
        conditions=tuple(sorted({condition for fact in facts for condition in fact.conditions})),
        age_s=stamped.age_s,
        unset=stamped.unset,
        backs=max((fact.backs for fact in facts), default=0),
        back_s=max((fact.back_s for fact in facts), default=0.0),
        frozen_s=max((fact.frozen_s for fact in facts), default=0.0),
        lost_percent=max(losses, default=None),
        outside=tuple({found.field: found for fact in facts for found in fact.outside}.values()),
        fields=_merged([found for fact in facts for found in fact.fields]),
        undecided=tuple(sorted({name for fact in facts for name in fact.undecided})),
    )


def _merged(fields: Sequence[FieldFact]) -> tuple[FieldFact, ...]:
    """Each field once, with the values of all publishers. Of different texts the first counts, and a problem before any value."""
    merged: dict[str, FieldFact] = {}
    for one in fields:
        before = merged.get(one.field, one)
        merged[one.field] = FieldFact(
            one.field,
            min((low for low in (before.low, one.low) if low is not None), default=None),
            max((high for high in (before.high, one.high) if high is not None), default=None),
            before.nan or one.nan,
            before.text,
            before.problem or one.problem,
        )
    return tuple(merged.values())
