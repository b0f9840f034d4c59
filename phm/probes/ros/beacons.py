"""Beacons in the child: what `phm.beacon` publishes is read, checked and passed on, the newest of each node.

What comes is from outside and is data: anyone may publish on this topic. Sizes and numbers are capped, a message
that is none is counted, and a stranger cannot take the place of a node that still beats.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from phm.beacon import BEACON, BEACON_FORMAT, MAX_LATE_S, MAX_NAME, MAX_NEIGHBOURS, MAX_NODES, MAX_TEXT, NAME, PERIODS_S
from phm.probes.ros.protocol import Heard, Message
from phm.ros_facts import BeaconFact, NeighbourFact

MAX_TAKES = 250
"""Messages read in one look, of which there are four a second: 200 processes that beat five times a second."""
MAX_BYTES = 2 * MAX_TEXT
MAX_STRANGERS = 200
"""Nodes that are kept though nobody configured them."""
FORGET_S = 60.0
"""A stranger that has been silent for longer is forgotten."""
MAX_WORD = 60
_ENDIAN = {b"\0\0": ">", b"\0\1": "<"}
_BEHIND_LEVEL = 13
MAX_AGE_S = 1e6
SILENT_MISSES = 3.0
"""A node that has missed this many beats may be another one from now on."""
DOUBT = (2.0, SILENT_MISSES)
"""Missed beats at which the daemon is told at once, so that checks look."""


RIVAL_BEATS = 3
"""So often must another process of the same name have beaten before it counts, and the first one have gone on for a period."""
MAX_RIVALS = 4


@dataclass(slots=True)
class _Rival:
    """Another process that beats under the name of one that has not fallen silent: how often it did, first and last."""

    since_s: float
    at_s: float
    beats: int = 1


@dataclass(slots=True)
class _Heard:
    """The newest beacon of one node, when it came (monotonic), and how much of its silence has been told.

    rivals: by witness.
    """

    fact: BeaconFact
    at_s: float
    doubt: int = 0
    rivals: dict[str, _Rival] = field(default_factory=dict)

    def now(self, now_s: float) -> BeaconFact:
        return replace(self.fact, age_s=round(max(0.0, now_s - self.at_s), 3), rivals=self._rivals(now_s))

    def meet(self, witness: str, at_s: float) -> None:
        """A rival has beaten."""
        rival, silent_s = self.rivals.get(witness), SILENT_MISSES * self.fact.period_s
        if rival is not None and at_s - rival.at_s <= silent_s:
            rival.at_s, rival.beats = at_s, rival.beats + 1
            return
        self.rivals = {name: one for name, one in self.rivals.items() if at_s - one.at_s <= silent_s}
        if len(self.rivals) < MAX_RIVALS:
            self.rivals[witness] = _Rival(at_s, at_s)

    def _rivals(self, now_s: float) -> int:
        """Those that beat now, and did while this one went on: a node that relieves another overlaps with it for a beat."""
        period_s = self.fact.period_s
        return sum(
            rival.beats >= RIVAL_BEATS
            and self.at_s - rival.since_s >= period_s
            and now_s - rival.at_s <= SILENT_MISSES * period_s
            for rival in self.rivals.values()
        )


class Ledger:
    """Whom the child has heard. Pure but for what it remembers: times are handed in, monotonic seconds.

    nodes: those of the configuration, which are never passed over for want of room.
    """

    def __init__(self, nodes: frozenset[str]) -> None:
        self._nodes = nodes
        self._heard: dict[str, _Heard] = {}
        self._news: set[str] = set()
        self._beats: set[str] = set()
        self.refused = 0
        self._told_refused = 0

    def add(self, format_name: str, text: str, at_s: float) -> None:
        """One message; `at_s`: when it came."""
        try:
            if format_name != BEACON_FORMAT:
                raise ValueError("another format, or another version")
            for name, fact, has_views in beacons_in(text):
                self._add(name, fact, has_views, at_s)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            self.refused += 1

    def news(self, now_s: float) -> Heard | None:
        """What there is to tell: all about whoever said something new, the age alone of whoever beats on."""
        for name, heard in list(self._heard.items()):
            seen = heard.now(now_s)
            doubt = sum(seen.missed > limit for limit in DOUBT)
            if doubt > heard.doubt or seen.rivals != heard.fact.rivals:
                self._news.add(name)
            heard.doubt, heard.fact = doubt, seen
            if name not in self._nodes and now_s - heard.at_s > FORGET_S:
                del self._heard[name]
        told = {name: self._heard[name].now(now_s) for name in self._news if name in self._heard}
        beats = self._beats - self._news
        ages = {name: self._heard[name].now(now_s).age_s for name in beats if name in self._heard}
        more_refused = self.refused != self._told_refused
        self._news, self._beats, self._told_refused = set(), set(), self.refused
        return Heard(beacons=told, ages=ages, refused=self.refused) if told or ages or more_refused else None

    def _add(self, name: str, fact: BeaconFact, has_views: bool, at_s: float) -> None:
        known = self._heard.get(name)
        if known is None:
            strangers = len(self._heard) - len(self._nodes & self._heard.keys())
            if name not in self._nodes and strangers >= MAX_STRANGERS:
                self.refused += 1
                return
        elif known.fact.witness != fact.witness:
            if known.now(at_s).missed <= SILENT_MISSES:
                known.meet(fact.witness, at_s)
                return  # two of one name: the one that was there first goes on to count
            known = None
        else:
            fact = replace(fact, rivals=known.fact.rivals, views=fact.views if has_views else known.fact.views)
        if known is None or has_views or known.doubt or _differs(known.fact, fact):
            self._news.add(name)
        self._beats.add(name)
        self._heard[name] = _Heard(fact, at_s, rivals=known.rivals if known is not None else {})


def _differs(old: BeaconFact, new: BeaconFact) -> bool:
    return (old.birth, old.late_s, old.period_s) != (new.birth, new.late_s, new.period_s)


class Beacons:
    """The reader, which is in no executor: its queue is emptied once a tick."""

    def __init__(self, node: Any, nodes: frozenset[str]) -> None:
        from rcl_interfaces.msg import Log
        from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

        self._ledger = Ledger(nodes)
        self._kind = Log
        self._looked_s = time.monotonic()
        qos = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=MAX_TAKES,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
            durability=QoSDurabilityPolicy.VOLATILE,
        )
        self._reader = node.create_subscription(Log, BEACON, _never_called, qos, raw=True)

    def look(self) -> list[Message]:
        """Called once a tick."""
        now_s, wall_ns = time.monotonic(), time.time_ns()
        longest_s, self._looked_s = now_s - self._looked_s, now_s
        for name, text, received_ns in self._taken():
            # The middleware's stamp is of a clock that may be set: it counts within what is possible.
            age_s = min(max((wall_ns - received_ns) / 1e9, 0.0), longest_s)
            self._ledger.add(name, text, now_s - age_s)
        news = self._ledger.news(now_s)
        return [news] if news is not None else []

    def _taken(self) -> Iterator[tuple[str, str, int]]:
        """What has come since the last look, oldest first. Taken as bytes: what is too long is never decoded."""
        handle = self._reader.handle
        with handle:
            for _ in range(MAX_TAKES):
                taken = handle.take_message(self._kind, True)
                if taken is None:
                    return
                data, info = taken
                try:
                    if len(data) > MAX_BYTES:
                        raise ValueError("too long")
                    name, text = log_texts(data)
                except (ValueError, struct.error):
                    self._ledger.refused += 1
                else:
                    yield name, text, int(info["received_timestamp"])


def log_texts(data: bytes) -> tuple[str, str]:
    """`name` and `msg` of a serialized rcl_interfaces/msg/Log; a message object for each beat cost the child a tenth of its time.

    CDR: 4 bytes of header, the stamp in 8, the level in 1; then each text from a multiple of 4 on, with its length and
    a final zero. Raises ValueError or struct.error for anything else.
    """
    if data[:2] not in _ENDIAN:
        raise ValueError("no plain CDR")
    length = struct.Struct(f"{_ENDIAN[data[:2]]}I")
    texts, at = [], _BEHIND_LEVEL
    for _ in range(2):
        at += -at % 4
        (size,) = length.unpack_from(data, at)
        end = at + length.size + size
        if not size or end > len(data) or data[end - 1]:
            raise ValueError("a text that is cut")
        texts.append(data[at + length.size : end - 1].decode("utf-8"))
        at = end
    return texts[0], texts[1]


def beacons_in(text: str) -> Iterator[tuple[str, BeaconFact, bool]]:
    """The nodes of one message: full name, fact (age 0), and whether it tells of neighbours.

    Raises ValueError, TypeError, KeyError, AttributeError, OverflowError or RecursionError for anything else.
    """
    if len(text) > MAX_TEXT:
        raise ValueError("too long")
    said = json.loads(text)
    witness, period_s = _word(said["witness"]), _number(said["period_s"], *PERIODS_S)
    nodes, told = said["nodes"], said.get("views")
    if not nodes or len(nodes) > MAX_NODES or len(told or ()) > MAX_NEIGHBOURS:
        raise ValueError("none, or too many")
    views = {_name(name): _view(view) for name, view in told.items()} if told else {}
    facts = []
    for name, node in nodes.items():
        fact = BeaconFact(
            age_s=0.0,
            period_s=period_s,
            late_s=_number(node["late_s"], 0.0, MAX_LATE_S),
            birth=_word(node["birth"]),
            beats=_count(node["beats"]),
            views=views,
            turns=_count(node["turns"]),
            witness=witness,
        )
        facts.append((_name(name), fact, told is not None))
    return iter(facts)


def _view(view: Mapping[str, Any]) -> NeighbourFact:
    alive = view["alive"]
    if not isinstance(alive, bool):
        raise TypeError("alive is neither true nor false")
    return NeighbourFact(alive, _number(view["age_s"], 0.0, MAX_AGE_S), _number(view["late_s"], 0.0, MAX_LATE_S))


def _name(name: object) -> str:
    if not isinstance(name, str) or len(name) > MAX_NAME or not NAME.fullmatch(name):
        raise ValueError("no full name of a node")
    return name


def _word(word: object) -> str:
    if not isinstance(word, str) or not word.isprintable() or not 0 < len(word) <= MAX_WORD:
        raise ValueError("no word")
    return word


def _number(number: object, least: float, most: float) -> float:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not math.isfinite(number):
        raise TypeError("no number")
    if not least <= number <= most:
        raise ValueError("a number that cannot be")
    return float(number)


def _count(number: object) -> int:
    if type(number) is not int or not 0 <= number < 2**63:
        raise TypeError("no count")
    return number


def _never_called(_: object) -> None:
    """rclpy wants a callback; without an executor nobody calls it."""
