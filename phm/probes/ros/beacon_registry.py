"""The newest beacon of each node, and which of the messages are genuine. Pure.

Anyone can publish on the beacon topic. So an unknown sender can neither replace a node that still sends heartbeats, nor use the
identity of another process, nor use up the space reserved for the configured nodes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

from phm.beacon import BEACON_FORMAT
from phm.facts.ros import BeaconFact
from phm.probes.ros.beacon_text import beacons_in
from phm.probes.ros.protocol import SelfReportUpdate

MAX_STRANGERS = 200
"""Most nodes kept that are not configured."""
FORGET_S = 60.0
"""A node that is not configured is forgotten after this much silence."""
SILENT_MISSES = 3.0
"""After this many missed heartbeats another process may take the name of the node."""
DOUBT = (2.0, SILENT_MISSES)
"""Numbers of missed heartbeats at which the daemon is informed immediately, so that checks run."""
COPIED_S = 10.0
"""A copied identity is reported for this long after its last message."""
PORTION, AGES_PORTION = 40, 1000
"""Beacons, and ages, in one message to the daemon: a beacon has at most 50 neighbours with names of 255 characters, so 17 kB."""
RIVAL_HEARTBEATS = 3
"""Another process of the same name counts after this many heartbeats, if the first one has continued for at least a period."""
MAX_RIVALS = 4


@dataclass(slots=True)
class _Rival:
    """Another process that sends heartbeats under the name of one that is not silent: their number, first and last time."""

    since_s: float
    at_s: float
    heartbeats: int = 1


@dataclass(slots=True)
class _NodeBeacon:
    """The newest beacon of one node, when it arrived (monotonic), and how much of its silence has been reported.

    Most beacons only continue, so a fact with the fields below is created for those that the daemon is sent.

    neighbours: its newest beacon that lists neighbours. ran_since: as of the fact; turned_since: its executor has run since then.
    rivals: by witness. copied_by: who used its identity last, and when. reported: what the daemon knows of the two.
    """

    fact: BeaconFact
    at_s: float
    neighbours: BeaconFact
    ran_since: float | None = None
    turned_since: float | None = None
    doubt: int = 0
    rivals: dict[str, _Rival] = field(default_factory=dict)
    copied_by: tuple[str, float] = ("", 0.0)
    reported: tuple[int, str] = (0, "")

    def ran(self, later: BeaconFact) -> tuple[float | None, float | None]:
        """Since when the executor has run twice, and once, as the next beacon of the same process shows: turns that this one does not
        count came after it. None: unknown."""
        turns = later.turns - self.fact.turns
        if later.birth != self.fact.birth:
            return None, None
        if turns <= 0:
            return self.ran_since, self.turned_since
        return self.at_s if turns > 1 else self.turned_since, self.at_s

    def age_s(self, now_s: float) -> float:
        return round(max(0.0, now_s - self.at_s), 3)

    def missed(self, now_s: float) -> float:
        """Heartbeats that have not come."""
        return self.age_s(now_s) / self.fact.period_s

    def others(self, now_s: float) -> tuple[int, str]:
        """The number of rivals, and who uses its identity."""
        who, at_s = self.copied_by
        return self._rivals(now_s) if self.rivals else 0, who if who and now_s - at_s <= COPIED_S else ""

    def now(self, now_s: float) -> BeaconFact:
        rivals, copied_by = self.others(now_s)
        return replace(
            self.fact,
            age_s=self.age_s(now_s),
            rivals=rivals,
            copied_by=copied_by,
            views=self.neighbours.views,
            full=self.neighbours.full,
            ran_since=self.ran_since,
        )

    def record_heartbeat(self, witness: str, at_s: float) -> None:
        """Record a heartbeat of a rival."""
        rival, silent_s = self.rivals.get(witness), SILENT_MISSES * self.fact.period_s
        if rival is not None and at_s - rival.at_s <= silent_s:
            rival.at_s, rival.heartbeats = at_s, rival.heartbeats + 1
            return
        self.rivals = {name: one for name, one in self.rivals.items() if at_s - one.at_s <= silent_s}
        if len(self.rivals) < MAX_RIVALS:
            self.rivals[witness] = _Rival(at_s, at_s)

    def _rivals(self, now_s: float) -> int:
        """Count those sending now that also sent while this one continued: a replacement overlaps for one heartbeat."""
        period_s = self.fact.period_s
        return sum(
            rival.heartbeats >= RIVAL_HEARTBEATS
            and self.at_s - rival.since_s >= period_s
            and now_s - rival.at_s <= SILENT_MISSES * period_s
            for rival in self.rivals.values()
        )


class BeaconRegistry:
    """The beacons that the child has received. No I/O and no clock: callers pass times, in monotonic seconds.

    nodes: the configured nodes, which are never dropped for lack of space. listed: returns the writers that discovery lists
    now, with the names of their nodes; None if unknown. Called at most once between two calls of `changes`.

    Invariant: a process (`witness`) is bound to the writer that used its name first, until that writer is silent and has
    left the graph.
    """

    def __init__(self, nodes: frozenset[str], listed: Callable[[], Mapping[bytes, str] | None] = lambda: None) -> None:
        self._nodes = nodes
        self._listed = functools.cache(listed)  # a call costs up to 2 ms, and anyone can cause one with each message
        self._writers: dict[str, bytes] = {}
        """The writer of each beacon, by its witness."""
        self._beacons: dict[str, _NodeBeacon] = {}
        self._changed: set[str] = set()
        self._received: set[str] = set()
        self.refused = 0
        self._reported_refused = 0

    def own_writers(self) -> set[bytes]:
        """The writers of the heartbeats of configured nodes."""
        witnesses = (self._beacons[name].fact.witness for name in self._nodes & self._beacons.keys())
        return {self._writers[witness] for witness in witnesses if witness in self._writers}

    def add(self, format_name: str, text: str, at_s: float, writer: bytes | None = None) -> None:
        """Process one message. `at_s`: when it arrived. writer: its sender, if the middleware reports it."""
        try:
            if format_name != BEACON_FORMAT:
                raise ValueError("another format, or another version")
            facts = list(beacons_in(text))
            if not self._is_genuine(facts[0][1].witness, writer, at_s):
                raise ValueError("a copied identity")
            for name, fact, has_views in facts:
                own = name in self._nodes
                views = {node: view for node, view in fact.views.items() if own and node in self._nodes}
                kept = fact if len(views) == len(fact.views) else replace(fact, views=views)
                self._add(name, kept, at_s, has_views=has_views and own)
                if writer is not None and self._is_of(name, fact.witness):
                    self._writers.setdefault(fact.witness, writer)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
            self.refused += 1

    def changes(self, now_s: float) -> SelfReportUpdate | None:
        """Return what to report: all of each beacon with new content, only the age of a beacon that just continues."""
        for name, beacon in list(self._beacons.items()):
            missed, others = beacon.missed(now_s), beacon.others(now_s)
            doubt = sum(missed > limit for limit in DOUBT)
            if doubt > beacon.doubt or others != beacon.reported:
                self._changed.add(name)
            beacon.doubt, beacon.reported = doubt, others
            if name not in self._nodes and now_s - beacon.at_s > FORGET_S:
                del self._beacons[name]
        changes = {name: self._beacons[name].now(now_s) for name in self._changed if name in self._beacons}
        unchanged = self._received - self._changed
        ages = {name: self._beacons[name].age_s(now_s) for name in unchanged if name in self._beacons}
        if len(self._writers) > len(self._beacons):
            witnesses = {beacon.fact.witness for beacon in self._beacons.values()}
            self._writers = {name: writer for name, writer in self._writers.items() if name in witnesses}
        more_refused = self.refused != self._reported_refused
        self._changed, self._received, self._reported_refused = set(), set(), self.refused
        self._listed.cache_clear()
        if not (changes or ages or more_refused):
            return None
        return SelfReportUpdate(beacons=changes, ages=ages, refused=self.refused)

    def _is_genuine(self, witness: str, writer: bytes | None, at_s: float) -> bool:
        """False for a message from another writer in the name of a process that is bound to its own writer."""
        bound = self._writers.get(witness)
        if writer is None or bound is None or bound == writer:
            return True
        theirs = [beacon for beacon in self._beacons.values() if beacon.fact.witness == witness]
        listed = self._listed()
        gone = listed is not None and bound not in listed
        if gone and all(at_s - beacon.at_s > SILENT_MISSES * beacon.fact.period_s for beacon in theirs):
            del self._writers[witness]
            return True
        name = (listed or {}).get(writer, "")
        for beacon in theirs:
            beacon.copied_by = (name or f"writer {writer.hex()}", at_s)
        return False

    def _is_of(self, name: str, witness: str) -> bool:
        beacon = self._beacons.get(name)
        return beacon is not None and beacon.fact.witness == witness

    def _add(self, name: str, fact: BeaconFact, at_s: float, *, has_views: bool) -> None:
        known = self._beacons.get(name)
        new = _NodeBeacon(fact, at_s, neighbours=fact)
        if known is None:
            others = len(self._beacons) - len(self._nodes & self._beacons.keys())
            if name not in self._nodes and others >= MAX_STRANGERS:
                self.refused += 1
                return
        elif known.fact.witness != fact.witness:
            if known.missed(at_s) <= SILENT_MISSES:
                known.record_heartbeat(fact.witness, at_s)
                return  # two processes of one name: the first one still counts
            known = None
        else:
            new.ran_since, new.turned_since = known.ran(fact)
            new.neighbours = fact if has_views else known.neighbours
            new.rivals, new.copied_by, new.reported = known.rivals, known.copied_by, known.reported
        if known is None or has_views or known.doubt or _differs(known.fact, fact):
            self._changed.add(name)
        self._received.add(name)
        self._beacons[name] = new


def _differs(old: BeaconFact, new: BeaconFact) -> bool:
    return _reported(old) != _reported(new)


def _reported(fact: BeaconFact) -> tuple[object, ...]:
    """The fields whose current values the daemon needs. Before the first turn of an executor its lateness means nothing."""
    return fact.birth, fact.late_s, fact.period_s, fact.turns > 0


def portions(changes: SelfReportUpdate, first: Collection[str]) -> list[SelfReportUpdate]:
    """Split the changes into messages of limited size, beginning with the nodes in `first`."""
    beacons = sorted(changes.beacons.items(), key=lambda item: item[0] not in first)
    ages = sorted(changes.ages.items(), key=lambda item: item[0] not in first)
    count = max(1, -(-len(beacons) // PORTION), -(-len(ages) // AGES_PORTION))
    return [
        replace(
            changes,
            beacons=dict(beacons[turn * PORTION : (turn + 1) * PORTION]),
            ages=dict(ages[turn * AGES_PORTION : (turn + 1) * AGES_PORTION]),
        )
        for turn in range(count)
    ]
