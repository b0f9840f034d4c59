"""Detects that discovery works between PHM and a container but no data arrives: several nodes together, with nothing received from any
of them. Pure, except that it queries the world.

One silent node may be hung. When all nodes of a container fall silent at the same moment, while discovery lists them and their
processes run, the cause is the path between them and PHM: a firewall, or a transport that they do not share. They must not have fallen
silent by a common cause, such as a process or an input (`phm_checks._witnesses`).
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import NamedTuple

from phm import api
from phm_checks._graph_evidence import NodeTopics
from phm_checks._process_matching import Wanted, match, repeated, wanted_nodes
from phm_checks._ros_facts import SILENT_PERIODS
from phm_checks._text import listed, span
from phm_checks._witnesses import WITNESSES, Arrivals, Causes, expected, independent

SILENT_S = 3.0
"""Well below the time after which the silence of a single node is reported, so that a blocked data path is known first."""
TOGETHER_S = 1.5
"""Beacons send five times a second and 1 Hz topics once: the last signs of life of nodes that are cut off at the same moment may be this
far apart."""
ASLEEP, AWAKE = "asleep", "awake"
OLD_SNAPSHOT_S = 2.0
SOON_S, SOON_PERIODS = 1.0, 5.0
"""The limit if beacons, which have their own threads, are among the silent and all processes sleep, so that none of them waits for a
CPU: one second of silence, or this many beacon periods, confirmed by a second look."""
CONFIRM_S = 0.4
"""Time until the second look: PHM's own child process may have been delayed too, with received data still in its queue."""
FRESH_S = 0.5
"""Snapshots arrive four times a second; an older one means that the child process is delayed."""
NOISE_S = 0.05
"""The ages of one sign of life differ by less than this between two snapshots, so none can belong to a different beacon message."""
PAUSE, REMEMBER_S = 2.0, 600.0
"""A silence that ended by itself shows how long this machine can pause: for REMEMBER_S, PHM waits for PAUSE times as long."""
ABSENT_S = 4.0
"""Nothing must have been received for this long from nodes that are not listed either. Below the time after which each node is
reported separately."""


class _Sign(NamedTuple):
    """The newest sign of life of one kind: its age, and the age from which on the next one is overdue."""

    age_s: float
    limit_s: float


class DataPath:
    """Data that PHM can receive from one container's nodes: beacons, and topics with a rate that exactly one node publishes."""

    def __init__(self, key: str, settings: api.Settings) -> None:
        self._key, self._grace_s = key, settings.ros.grace
        self._wanted = [node for node in wanted_nodes(settings) if node.container == key]
        self._ends = {node.name: NodeTopics.of(node.name, settings.ros.topics) for node in self._wanted}
        self._arrivals = Arrivals(key, settings)
        self._generation, self._met_at = "", 0.0
        self._cut_at = 0.0
        """The last sign of life before they were reported as cut off came at this moment at the latest; before a report, PHM's first look
        at this run of the container."""
        self._received_since = False
        """Whether a later one was seen, or another cause of their silence."""
        self.cut = False
        """Whether they were reported as cut off in this run of the container, and neither was seen since."""
        self._pause_s, self._paused_at = 0.0, 0.0
        """Duration of the last silence of all nodes that ended by itself, and when it ended."""
        self._blocked_generation = ""
        """The container generation in which they were last cut off; cleared when data is received in another generation."""
        self.never_received = False
        """For the last non-empty result of `why`: whether nothing was ever received in this container generation."""
        self.by_topics = False
        """The same: whether it rests on topics, whose sources may only pause, and not on beacons alone."""

    def why(self, world: api.World, generation: str) -> str:
        """The evidence as text; empty while anything is received, or if the state is unknown. generation: the container's current one."""
        if generation != self._generation:
            self._generation, self._met_at = generation, world.clock.mono()
            self._cut_at, self._received_since, self.cut = self._met_at, False, False
        return self._why(world)

    def interrupted(self) -> None:
        """The container is paused or has ended: the silence of that time says nothing about the path, unless they were cut off just before."""
        if not self.cut:
            self._generation = ""

    def unobserved(self, world: api.World) -> bool:
        """Whether nothing has shown yet that data arrive, since PHM's first look at this run of the container or since they were reported as
        cut off. Call after `why` and `absent`, if both are empty."""
        if len(self._wanted) < WITNESSES:
            return False
        if not self._received_since:
            self._received_since = self._explained(world)
            self.cut = self.cut and not self._received_since
        return not self._received_since

    def _explained(self, world: api.World) -> bool:
        """Whether something was received since, here or by another node, or a process has ended or is stopped."""
        try:
            fact = world.ros.snapshot()
            if fact.age_s > OLD_SNAPSHOT_S:
                return False
            ages = [sign.age_s - fact.age_s for node in self._wanted for sign in self._signs(node, fact)]
            if world.clock.mono() - min([*ages, self._arrivals.newest_s(fact)]) > self._cut_at:
                return True
            # Names arrive as data: a child that has received nothing else, e.g. a new one, has received these since.
            named = not ages and any(fact.nodes.get(node.name) for node in self._wanted)
            return named or self._others_receive(fact) or not self._state(world)
        except api.CannotTell:
            return False

    def _report(self, world: api.World, silent_s: float) -> None:
        """They are reported as cut off, after silence of this duration."""
        self._blocked_generation = self._generation
        self._cut_at, self._received_since, self.cut = world.clock.mono() - silent_s + NOISE_S, False, True

    def waiting(self, world: api.World, generation: str) -> bool:
        """Whether the path was blocked in the previous generation and it is not yet known if data arrives in this one. Call after `why`."""
        if self._blocked_generation in ("", generation):
            return False
        now = world.clock.mono()
        if now - self._met_at > 2 * self._grace_s or self._received(world, now):
            self._blocked_generation = ""
        return bool(self._blocked_generation)

    def _received(self, world: api.World, now: float) -> bool:
        """Whether any node has given a sign of life in this generation."""
        try:
            fact = world.ros.snapshot()
        except api.CannotTell:
            return False
        ages = [age for node in self._wanted if (age := self._silent_s(node, fact)) is not None]
        return now - min([*ages, self._arrivals.newest_s(fact)]) > self._met_at

    def _why(self, world: api.World) -> str:
        if len(self._wanted) < WITNESSES:
            return ""
        now = world.clock.mono()
        try:
            fact = world.ros.snapshot()
        except api.CannotTell:
            return ""
        if fact.age_s > OLD_SNAPSHOT_S or self._others_receive(fact):
            return ""
        silent = [found for node in self._wanted if (found := self._silent_s(node, fact)) is not None]
        # Data from before this generation came from other processes, whose names may stay listed until their lease ends.
        in_this_generation = silent and now - max(silent) > self._met_at
        if in_this_generation and len(silent) >= WITNESSES and (silent_s := self._cut_off_s(world, fact, silent)):
            self.never_received = False
            self._report(world, silent_s)
            return (
                f"nothing received from any of its {len(silent)} nodes for {span(silent_s)}, though discovery lists them and "
                "their processes are running"
            )
        if not silent and now - self._met_at > self._grace_s and self._nameless(fact) and self._run(world):
            self.never_received = True
            self._report(world, 0.0)
            return (
                f"publishers are discovered, but neither their node names nor a sample has been received for {span(fact.up_s)}, though "
                f"the processes of {listed([node.short for node in self._wanted], 3)} are running"
            )
        return ""

    def _cut_off_s(self, world: api.World, fact: api.RosFact, silent: Sequence[float]) -> float:
        """How long the listed nodes, silent for these times, have been cut off; 0 if they may not be."""
        quiet = self._quiet(fact, silent)
        # A reported fault persists until something is received.
        if world.clock.mono() - min(quiet) <= self._cut_at:
            return min(quiet) if self._run(world) else 0.0
        if not self._all_overdue(fact, listed_only=True):
            return 0.0
        causes = self._causes(fact)
        long = _together(quiet, SILENT_S, TOGETHER_S)
        return min(quiet) if long and self._run(world, causes) else self._soon(world, fact, silent, causes)

    def _causes(self, fact: api.RosFact) -> dict[str, set[str]]:
        """By name of each silent node, what may have silenced it. A beacon has its own timer; topics may wait for inputs."""
        silent = [node for node in self._wanted if self._silent_s(node, fact) is not None]
        beacons = {node.name for node in silent if self._beacon_ended(node, fact)}
        self.by_topics = len(beacons) < WITNESSES
        causes = Causes(fact)
        return {node.name: {node.name} if node.name in beacons else causes.of(node.name) for node in silent}

    def _beacon_ended(self, node: Wanted, fact: api.RosFact) -> bool:
        """Whether its beacon fell silent, too, and not long before its topics."""
        beacon = fact.beacons.get(node.name)
        newest_s = min(sign.age_s for sign in self._signs(node, fact))
        return beacon is not None and beacon.silent_s - newest_s <= max(TOGETHER_S, SILENT_PERIODS * beacon.period_s)

    def _quiet(self, fact: api.RosFact, silent: Sequence[float]) -> list[float]:
        """These times, and that since anything else was received from the container, if it is shorter: then the path works."""
        return [*silent, min(*silent, self._arrivals.newest_s(fact))]

    def _soon(
        self, world: api.World, fact: api.RosFact, silent: Sequence[float], causes: Mapping[str, Collection[str]]
    ) -> float:
        """How long all of them have been silent, if that is certain before SILENT_S; otherwise 0."""
        periods = [fact.beacons[node.name].period_s for node in self._wanted if node.name in fact.beacons]
        all_silent = len(silent) == len(self._wanted)
        if not all_silent or len(periods) < WITNESSES or fact.age_s > FRESH_S:
            return 0.0
        now = world.clock.mono()
        pause_s = self._pause_s if now - self._paused_at < REMEMBER_S else 0.0
        limit_s = max(SOON_S, SOON_PERIODS * max(periods), PAUSE * pause_s)
        near_s = max(2 * max(periods), FRESH_S)
        if not _together(self._quiet(fact, silent), limit_s - CONFIRM_S, near_s) or self._run(world, causes) != ASLEEP:
            return 0.0
        world.clock.wait(threading.Event(), max(CONFIRM_S, limit_s - min(silent)))
        try:
            again = world.ros.snapshot()
        except api.CannotTell:
            return 0.0
        passed_s = world.clock.mono() - now
        later = [found for node in self._wanted if (found := self._silent_s(node, again)) is not None]
        if later and min(later) < min(silent):
            self._pause_s, self._paused_at = min(silent) + passed_s - min(later), now
            return 0.0
        if again.age_s > FRESH_S or len(later) != len(self._wanted):
            return 0.0
        quiet = self._quiet(again, later)
        return min(quiet) if _together(quiet, limit_s, near_s) else 0.0

    def absent(self, world: api.World) -> str:
        """The evidence that discovery does not work either, although all nodes run; empty if unknown. Call after `why`."""
        now = world.clock.mono()
        if len(self._wanted) < WITNESSES or now - self._met_at < self._grace_s:
            return ""
        try:
            fact = world.ros.snapshot()
        except api.CannotTell:
            return ""
        received = [sign.age_s for node in self._wanted for sign in self._signs(node, fact)]
        listed_ones = [node.name for node in self._wanted if fact.nodes.get(node.name)]
        if fact.age_s > OLD_SNAPSHOT_S or fact.up_s < self._grace_s or listed_ones or not received:
            return ""
        if self._others_receive(fact) or not self._all_overdue(fact, listed_only=False):
            return ""
        silent_s = min(min(received) - fact.age_s, self._arrivals.newest_s(fact))
        running = (ASLEEP, AWAKE) if self.cut else (ASLEEP,)
        if silent_s < ABSENT_S or now - silent_s < self._met_at or self._run(world) not in running:
            return ""
        self._report(world, silent_s)
        return (
            f"none of its {len(self._wanted)} nodes is listed, and nothing has been received from them for {span(silent_s)}, "
            "though their processes are running"
        )

    def _others_receive(self, fact: api.RosFact) -> bool:
        """Whether a node elsewhere, which PHM receives, still receives one of them: their container's network is intact."""
        here = {node.name for node in self._wanted}
        return any(fact.received_elsewhere(name, without=here) is not None for name in here)

    def _silent_s(self, node: Wanted, fact: api.RosFact) -> float | None:
        """Seconds since the last sign of life of a listed node. None if it is not listed, or never gave a sign and so proves nothing."""
        if not fact.nodes.get(node.name):
            return None
        ages = [sign.age_s for sign in self._signs(node, fact)]
        return max(0.0, min(ages) - fact.age_s) if ages else None

    def _all_overdue(self, fact: api.RosFact, *, listed_only: bool) -> bool:
        """Whether the next sign of life of each node is overdue: between two messages of a slow topic or beacon, nothing is received
        either."""
        nodes = [node for node in self._wanted if fact.nodes.get(node.name) or not listed_only]
        signs = [list(self._signs(node, fact)) for node in nodes]
        return all(_overdue(of_node, fact.age_s) for of_node in signs if of_node)

    def _signs(self, node: Wanted, fact: api.RosFact) -> Iterable[_Sign]:
        beacon = fact.beacons.get(node.name)
        if beacon is not None:
            yield _Sign(beacon.silent_s, SILENT_PERIODS * beacon.period_s)
        for topic, rate_hz in self._ends[node.name].rates if expected(node.name, fact) else ():
            rate = fact.topics.get(topic, api.TopicFact()).rate
            if rate is not None and rate.silent_s is not None:
                yield _Sign(max(0.0, rate.silent_s - rate.not_counted_s), rate.limit_s or SILENT_PERIODS / rate_hz)

    def _nameless(self, fact: api.RosFact) -> bool:
        """Whether publishers are discovered without node names: names arrive as data, publishers through discovery."""
        if fact.up_s < self._grace_s or any(node.name in fact.nodes for node in self._wanted):
            return False
        topics = [fact.topics.get(topic, api.TopicFact()) for ends in self._ends.values() for topic, _ in ends.rates]
        found = [end.node for topic in topics for end in topic.publishers]
        received = any(topic.rate is not None and topic.rate.silent_s is not None for topic in topics)
        return len(found) >= WITNESSES and not any(found) and not received

    def _run(self, world: api.World, causes: Mapping[str, Collection[str]] | None = None) -> str:
        """AWAKE or ASLEEP if each node has at least one process, none is stopped, and WITNESSES nodes share neither a process nor another
        cause of silence; otherwise empty. Called only if there is a reason. causes: of the silent nodes; default: all nodes, without any.
        """
        try:
            return self._state(world, causes)
        except api.CannotTell:
            return ""

    def _state(self, world: api.World, causes: Mapping[str, Collection[str]] | None = None) -> str:
        """The same; raises CannotTell."""
        processes = world.docker.processes(self._key)
        found, _ = match(self._wanted, processes, {})
        every = repeated(self._wanted, processes, found) | {name: [one.process] for name, one in found.items()}
        states = [one.state[:1] for own in every.values() for one in own]
        if len(every) != len(self._wanted) or any(state in ("T", "t") for state in states):
            return ""
        shared: list[set[Hashable]] = [
            {one.pid for one in every[name]}.union(why) for name, why in (causes or dict.fromkeys(every, ())).items()
        ]
        if independent(shared) < WITNESSES:
            return ""
        return ASLEEP if all(state == "S" for state in states) else AWAKE


def _overdue(signs: Sequence[_Sign], delay_s: float) -> bool:
    """Whether a node should have given another sign of life since its newest one. delay_s: age of the snapshot, which does not count as silence."""
    newest_s = min(sign.age_s for sign in signs)
    # A topic that had ended before the newest sign does not show that the next one is overdue.
    limits = [sign.limit_s for sign in signs if sign.age_s - newest_s <= sign.limit_s]
    return newest_s - delay_s > min(limits)


def _together(silent: Sequence[float], limit_s: float, apart_s: float) -> bool:
    """Whether all have been silent for longer than `limit_s`, beginning at most `apart_s` apart."""
    return min(silent) > limit_s and max(silent) - min(silent) <= apart_s
