"""Whether discovery between PHM and a container passes and no data does: several nodes at once, of which nothing is heard. Pure but
for asking the world.

One node that says nothing may hang. That all nodes of a container fall silent in the same moment, while discovery lists them and
their processes run, is the way between them and PHM: a firewall, or a transport that is not shared.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

from phm import api
from phm_checks._graph_evidence import NodeTopics
from phm_checks._process_matching import Wanted, match
from phm_checks._text import listed, span

WITNESSES = 2
SILENT_S = 3.0
"""Well below the time after which the silence of a single node is told, so that this is known before."""
TOGETHER_S = 1.5
"""Beacons beat five times a second and topics of 1 Hz once: so far apart may be the last signs of nodes cut off at once."""
ASLEEP, AWAKE = "asleep", "awake"
OLD_PICTURE_S = 2.0
SOON_S, SOON_PERIODS = 1.0, 5.0
"""Where beacons that have threads of their own are among the silent, and all processes sleep, so none of them waits for a processor:
a second of silence, or so many beats, which a second look must confirm."""
CONFIRM_S = 0.4
"""Until the second look: PHM's own child, too, may have been held up, and what has come be still on its way through it."""
FRESH_S = 0.5
"""Pictures come four times a second; an older one means that the child is held up."""
NOISE_S = 0.05
"""Ages of one sign in two pictures differ by less: none can be of another beat."""
PAUSE, REMEMBER_S = 2.0, 600.0
"""A silence that ended by itself shows what this machine does at times: so many times as long is waited for, for so long."""
ABSENT_S = 4.0
"""So long nothing may have been heard of nodes that are not listed either. Below the time after which each is told by itself."""


class DataPath:
    """What may be heard of one container's nodes: beacons, and topics with a rate that one node alone publishes."""

    def __init__(self, key: str, settings: api.Settings) -> None:
        self._key, self._grace_s = key, settings.ros.grace
        names = [f"/{api.topic_id(node.name)}" for node in settings.ros.nodes]
        words = {f"/{api.topic_id(node.name)}": tuple(node.process) for node in settings.ros.nodes}
        own = [name for name in names if settings.container_of_node(name) == key]
        self._wanted = [Wanted(name, key, words[name]) for name in own]
        self._ends = {name: NodeTopics.of(name, settings.ros.topics) for name in own}
        self._generation, self._met_at = "", 0.0
        self._cut_at = 0.0
        """The last sign before they were told to be cut off was at this moment at the latest."""
        self._pause_s, self._paused_at = 0.0, 0.0
        """The last silence of all that ended by itself, and when."""
        self._blocked_generation = ""
        """In which it was blocked last, until something was heard in another."""
        self.never_heard = False
        """Of the last answer that said why: whether nothing was ever heard in this life."""

    def why(self, world: api.World, generation: str) -> str:
        """The evidence in words; empty while anything is heard, or when it cannot be told. life: of the container, now."""
        why = self._why(world, generation)
        if why:
            self._blocked_generation = generation
        return why

    def waiting(self, world: api.World, generation: str) -> bool:
        """It was blocked in the life before, and whether data come in this one is not known yet. After `why`."""
        if self._blocked_generation in ("", generation):
            return False
        now = world.clock.mono()
        if now - self._met_at > 2 * self._grace_s or self._heard(world, now):
            self._blocked_generation = ""
        return bool(self._blocked_generation)

    def _heard(self, world: api.World, now: float) -> bool:
        """Whether any node has given a sign in this life."""
        try:
            fact = world.ros.look()
        except api.CannotTell:
            return False
        ages = (self._silent_s(node, fact) for node in self._wanted)
        return any(age is not None and now - age > self._met_at for age in ages)

    def _why(self, world: api.World, generation: str) -> str:
        if len(self._wanted) < WITNESSES:
            return ""
        now = world.clock.mono()
        if generation != self._generation:
            self._generation, self._met_at = generation, now
        try:
            fact = world.ros.look()
        except api.CannotTell:
            return ""
        if fact.age_s > OLD_PICTURE_S:
            return ""
        silent = [found for node in self._wanted if (found := self._silent_s(node, fact)) is not None]
        # What was heard before this life was heard of other processes, whose names may be listed until their lease ends.
        in_this_life = silent and now - max(silent) > self._met_at
        if in_this_life and len(silent) >= WITNESSES:
            # What was told stays so until something is heard.
            long = _together(silent, SILENT_S, TOGETHER_S) or now - min(silent) <= self._cut_at
            silent_s = min(silent) if long and self._run(world) else self._soon(world, fact, silent)
            if silent_s:
                self.never_heard, self._cut_at = False, world.clock.mono() - silent_s + NOISE_S
                return (
                    f"nothing received from any of its {len(silent)} nodes for {span(silent_s)}, though discovery lists them and "
                    "their processes are running"
                )
        if not silent and now - self._met_at > self._grace_s and self._nameless(fact) and self._run(world):
            self.never_heard = True
            return (
                f"publishers are discovered, but neither their node names nor a sample has been received for {span(fact.up_s)}, though "
                f"the processes of {listed([node.short for node in self._wanted], 3)} are running"
            )
        return ""

    def _soon(self, world: api.World, fact: api.RosFact, silent: Sequence[float]) -> float:
        """How long all of them have been silent, where that is certain before SILENT_S; else 0."""
        beats = [fact.beacons[node.name].period_s for node in self._wanted if node.name in fact.beacons]
        all_heard_of = len(silent) == len(self._wanted)
        if not all_heard_of or len(beats) < WITNESSES or fact.age_s > FRESH_S:
            return 0.0
        now = world.clock.mono()
        pause_s = self._pause_s if now - self._paused_at < REMEMBER_S else 0.0
        limit_s = max(SOON_S, SOON_PERIODS * max(beats), PAUSE * pause_s)
        near_s = max(2 * max(beats), FRESH_S)
        if not _together(silent, limit_s - CONFIRM_S, near_s) or self._run(world) != ASLEEP:
            return 0.0
        world.clock.wait(threading.Event(), max(CONFIRM_S, limit_s - min(silent)))
        try:
            again = world.ros.look()
        except api.CannotTell:
            return 0.0
        passed_s = world.clock.mono() - now
        later = [found for node in self._wanted if (found := self._silent_s(node, again)) is not None]
        if later and min(later) < min(silent):
            self._pause_s, self._paused_at = min(silent) + passed_s - min(later), now
            return 0.0
        sure = again.age_s <= FRESH_S and len(later) == len(self._wanted) and _together(later, limit_s, near_s)
        return min(later) if sure else 0.0

    def absent(self, world: api.World) -> str:
        """The evidence that discovery does not pass either, though all nodes run; empty where that cannot be told. After `why`."""
        now = world.clock.mono()
        if len(self._wanted) < WITNESSES or now - self._met_at < self._grace_s:
            return ""
        try:
            fact = world.ros.look()
        except api.CannotTell:
            return ""
        heard = [age_s for node in self._wanted for age_s in self._signs(node, fact)]
        listed_ones = [node.name for node in self._wanted if fact.nodes.get(node.name)]
        if fact.age_s > OLD_PICTURE_S or fact.up_s < self._grace_s or listed_ones or not heard:
            return ""
        silent_s = min(heard) - fact.age_s
        if silent_s < ABSENT_S or now - silent_s < self._met_at or self._run(world) != ASLEEP:
            return ""
        return (
            f"none of its {len(self._wanted)} nodes is listed, and nothing has been received from them for {span(silent_s)}, "
            "though their processes are running"
        )

    def _silent_s(self, node: Wanted, fact: api.RosFact) -> float | None:
        """Since the last sign of a node that is listed; None: it is not, or it never gave one, so it is no witness."""
        if not fact.nodes.get(node.name):
            return None
        ages = list(self._signs(node, fact))
        return max(0.0, min(ages) - fact.age_s) if ages else None

    def _signs(self, node: Wanted, fact: api.RosFact) -> Iterable[float]:
        beacon = fact.beacons.get(node.name)
        if beacon is not None:
            yield beacon.silent_s
        for topic, _ in self._ends[node.name].rates:
            rate = fact.topics.get(topic, api.TopicFact()).rate
            if rate is not None and rate.silent_s is not None:
                yield max(0.0, rate.silent_s - rate.not_counted_s)

    def _nameless(self, fact: api.RosFact) -> bool:
        """Nodes' names come as data, that there are publishers with discovery."""
        if fact.up_s < self._grace_s or any(node.name in fact.nodes for node in self._wanted):
            return False
        topics = [fact.topics.get(topic, api.TopicFact()) for ends in self._ends.values() for topic, _ in ends.rates]
        found = [end.node for topic in topics for end in topic.publishers]
        heard = any(topic.rate is not None and topic.rate.silent_s is not None for topic in topics)
        return len(found) >= WITNESSES and not any(found) and not heard

    def _run(self, world: api.World) -> str:
        """AWAKE or ASLEEP where each node has a process of its own, none of them stopped; else empty. Asked only for a reason."""
        try:
            found, _ = match(self._wanted, world.docker.processes(self._key), {})
        except api.CannotTell:
            return ""
        states = [one.process.state[:1] for one in found.values()]
        if len(states) != len(self._wanted) or any(state in ("T", "t") for state in states):
            return ""
        return ASLEEP if all(state == "S" for state in states) else AWAKE


def _together(silent: Sequence[float], limit_s: float, apart_s: float) -> bool:
    """Whether all have been silent for longer than that, and since about the same moment."""
    return min(silent) > limit_s and max(silent) - min(silent) <= apart_s
