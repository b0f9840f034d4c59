"""The newest beacon of each node, and which of the messages are what they claim to be. Pure.

Anyone may publish on the beacons' topic: a stranger can neither take the place of a node that still beats, nor speak with
the identity of another process, nor use up the room of the configured nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

from phm.beacon import BEACON_FORMAT
from phm.facts.ros import BeaconFact
from phm.probes.ros.beacon_text import beacons_in
from phm.probes.ros.protocol import Heard

MAX_STRANGERS = 200
"""Nodes that are kept though they are not configured."""
FORGET_S = 60.0
"""A stranger that has been silent for longer is forgotten."""
SILENT_MISSES = 3.0
"""A node that has missed this many beats may be another one from now on."""
DOUBT = (2.0, SILENT_MISSES)
"""Missed beats at which the daemon is informed immediately, so that checks look."""
COPIED_S = 10.0
"""A copied identity is reported for so long after its last message."""
PORTION, AGES_PORTION = 40, 1000
"""Beacons in one message to the daemon: each has 50 neighbours at most, with names of 255 characters, so 17 kB. And ages."""
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
    """The newest beacon of one node, when it came (monotonic), and how much of its silence has been reported.

    rivals: by witness. copied_by: who used its identity last, and when.
    """

    fact: BeaconFact
    at_s: float
    doubt: int = 0
    rivals: dict[str, _Rival] = field(default_factory=dict)
    copied_by: tuple[str, float] = ("", 0.0)

    def now(self, now_s: float) -> BeaconFact:
        who, at_s = self.copied_by
        return replace(
            self.fact,
            age_s=round(max(0.0, now_s - self.at_s), 3),
            rivals=self._rivals(now_s),
            copied_by=who if who and now_s - at_s <= COPIED_S else "",
        )

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


class BeaconRegistry:
    """Whose beacons the child has received. Pure but for what it remembers: times are handed in, monotonic seconds.

    nodes: those of the configuration, which are never passed over for want of room. listed: asked for the writers that
    discovery lists now, with the names of their nodes; None where it does not know.

    Invariant: a process (`witness`) is bound to the writer that used its name first, until that one has fallen silent and
    left the graph.
    """

    def __init__(self, nodes: frozenset[str], listed: Callable[[], Mapping[bytes, str] | None] = lambda: None) -> None:
        self._nodes = nodes
        self._listed = listed
        self._writers: dict[str, bytes] = {}
        """By witness."""
        self._heard: dict[str, _Heard] = {}
        self._news: set[str] = set()
        self._beats: set[str] = set()
        self.refused = 0
        self._told_refused = 0

    def own_writers(self) -> set[bytes]:
        """Those that the configured nodes beat with."""
        heard = (self._heard[name].fact.witness for name in self._nodes & self._heard.keys())
        return {self._writers[witness] for witness in heard if witness in self._writers}

    def add(self, format_name: str, text: str, at_s: float, writer: bytes | None = None) -> None:
        """One message; `at_s`: when it came. writer: who wrote it, where the middleware says so."""
        try:
            if format_name != BEACON_FORMAT:
                raise ValueError("another format, or another version")
            facts = list(beacons_in(text))
            if not self._is_genuine(facts[0][1].witness, writer, at_s):
                raise ValueError("a copied identity")
            for name, fact, has_views in facts:
                views = {node: view for node, view in fact.views.items() if node in self._nodes}
                own = name in self._nodes
                self._add(name, replace(fact, views=views if own else {}), at_s, has_views=has_views and own)
                if writer is not None and self._is_of(name, fact.witness):
                    self._writers.setdefault(fact.witness, writer)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            self.refused += 1

    def news(self, now_s: float) -> Heard | None:
        """What there is to tell: all about whoever said something new, the age alone of whoever beats on."""
        for name, heard in list(self._heard.items()):
            seen = heard.now(now_s)
            doubt = sum(seen.missed > limit for limit in DOUBT)
            others = (seen.rivals, seen.copied_by) != (heard.fact.rivals, heard.fact.copied_by)
            if doubt > heard.doubt or others:
                self._news.add(name)
            heard.doubt, heard.fact = doubt, seen
            if name not in self._nodes and now_s - heard.at_s > FORGET_S:
                del self._heard[name]
        news = {name: self._heard[name].now(now_s) for name in self._news if name in self._heard}
        beats = self._beats - self._news
        ages = {name: self._heard[name].now(now_s).age_s for name in beats if name in self._heard}
        if len(self._writers) > len(self._heard):
            witnesses = {heard.fact.witness for heard in self._heard.values()}
            self._writers = {name: writer for name, writer in self._writers.items() if name in witnesses}
        more_refused = self.refused != self._told_refused
        self._news, self._beats, self._told_refused = set(), set(), self.refused
        return Heard(beacons=news, ages=ages, refused=self.refused) if news or ages or more_refused else None

    def _is_genuine(self, witness: str, writer: bytes | None, at_s: float) -> bool:
        """False for what another writer says in the name of a process that is bound to its own."""
        bound = self._writers.get(witness)
        if writer is None or bound is None or bound == writer:
            return True
        theirs = [heard for heard in self._heard.values() if heard.fact.witness == witness]
        listed = self._listed()
        gone = listed is not None and bound not in listed
        if gone and all(at_s - heard.at_s > SILENT_MISSES * heard.fact.period_s for heard in theirs):
            del self._writers[witness]
            return True
        name = (listed or {}).get(writer, "")
        for heard in theirs:
            heard.copied_by = (name or f"writer {writer.hex()}", at_s)
        return False

    def _is_of(self, name: str, witness: str) -> bool:
        heard = self._heard.get(name)
        return heard is not None and heard.fact.witness == witness

    def _add(self, name: str, fact: BeaconFact, at_s: float, *, has_views: bool) -> None:
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
            views = fact.views if has_views else known.fact.views
            fact = replace(fact, rivals=known.fact.rivals, copied_by=known.fact.copied_by, views=views)
        if known is None or has_views or known.doubt or _differs(known.fact, fact):
            self._news.add(name)
        self._beats.add(name)
        new = self._heard[name] = _Heard(fact, at_s)
        if known is not None:
            new.rivals, new.copied_by = known.rivals, known.copied_by


def _differs(old: BeaconFact, new: BeaconFact) -> bool:
    return _told(old) != _told(new)


def _told(fact: BeaconFact) -> tuple[object, ...]:
    """What the daemon must know as it is now. Before the first turn of an executor its lateness means nothing."""
    return fact.birth, fact.late_s, fact.period_s, fact.turns > 0


def portions(news: Heard, first: Collection[str]) -> list[Heard]:
    """The same in messages of which none is too long, those of the nodes in `first` first."""
    beacons = sorted(news.beacons.items(), key=lambda item: item[0] not in first)
    ages = sorted(news.ages.items(), key=lambda item: item[0] not in first)
    count = max(1, -(-len(beacons) // PORTION), -(-len(ages) // AGES_PORTION))
    return [
        replace(
            news,
            beacons=dict(beacons[turn * PORTION : (turn + 1) * PORTION]),
            ages=dict(ages[turn * AGES_PORTION : (turn + 1) * AGES_PORTION]),
        )
        for turn in range(count)
    ]
