"""Slot 7: each configured topic has its publishers and subscribers, with the right type and compatible QoS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._endpoint_history import EndpointHistory, Key
from phm_checks._endpoint_matching import SHOWN, named_sides
from phm_checks._graph_gaps import GraphGaps
from phm_checks._node_activity import all_alive
from phm_checks._on_demand import OTHERS_S, Use, on_demand, use_of_output
from phm_checks._ros_facts import full_name, graph_snapshot
from phm_checks._similar_names import sentence, similar_names
from phm_checks._text import did_you_mean, joined, last, listed, span
from phm_checks._topic_mismatches import TopicMismatches
from phm_checks._topic_results import numbers, problem, unit_id

SETTLE_S = 1.5
"""Endpoints of a terminating node may leave the graph so much earlier than the node is known to be dead."""
SURE_S = 0.2
"""Settle time for a mismatch between existing endpoints of live nodes: a terminating node cannot be its cause."""
STRAY_S = 10.0
"""A subscription to a similar name may wait for its own publisher, which starts later."""


class Topics(api.Check):
    """The connections of all configured topics, one unit each, from one graph snapshot."""

    name, slot, layer = "topics", Slot.TOPICS, Layer.ROS
    period_s = 1.0

    def __init__(
        self,
        topics: Sequence[api.TopicSettings],
        units: Sequence[api.Unit],
        grace_s: float,
        homes: Mapping[str, str],
    ) -> None:
        """`homes`: the container of each named node, by the node's full name."""
        self._topics = tuple(topics)
        self._units = tuple(units)
        self._targets = {unit.id: unit.target for unit in units}
        self._grace_s = grace_s
        self._homes = dict(homes)
        self._ends = EndpointHistory()
        self._mismatched: dict[str, api.Result] = {}
        """The last mismatch between existing endpoints per topic: kept while one of them is being recreated."""
        self._failed: dict[str, str] = {}
        """The condition of the last result per topic that was not a WARN."""
        self._stray_since: dict[str, float] = {}
        self._gaps = GraphGaps()
        self._mismatches = TopicMismatches(self._targets, self._homes)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        topics = settings.ros.topics
        lifecycle = {api.topic_id(node.name) for node in settings.ros.nodes if node.ready and node.ready.lifecycle}
        units = []
        for topic in topics:
            key = settings.container_of_topic(topic)
            nodes = dict.fromkeys(api.topic_id(node) for node in (*topic.publishers, *topic.subscribers))
            needs = [*(f"container/{key}", f"network/{key}")] if key else []
            needs += [f"nodes/{node}" for node in nodes]
            # A lifecycle node may have endpoints, and publish, only while it is active.
            needs += [f"node_ready/{node}" for node in nodes if node in lifecycle]
            units.append(
                api.Unit(
                    unit_id(topic),
                    needs=tuple(needs),
                    target=key,
                    settle_s=SETTLE_S,
                    grace_s=settings.ros.grace,
                    node=next(map(full_name, topic.publishers), ""),
                )
            )
        named = {full_name(node) for topic in topics for node in (*topic.publishers, *topic.subscribers)}
        homes = {node: settings.container_of_node(node) for node in named}
        return [cls(topics, units, settings.ros.grace, homes)] if topics else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each topic; STALE for all without a recent graph snapshot."""
        try:
            fact = graph_snapshot(world)
        except api.CannotTell as reason:
            return {unit_id(topic): api.stale(str(reason)) for topic in self._topics}
        now = world.clock.mono()
        return {unit_id(topic): self._judge(topic, fact, now) for topic in self._topics}

    def _judge(self, topic: api.TopicSettings, fact: api.RosFact, now: float) -> api.Result:
        """A missing endpoint first, then the worst of: type, QoS, similar name."""
        seen = fact.topics.get(full_name(topic.name), api.TopicFact())
        unknown = self._gaps.judge(topic, seen, now)
        if unknown is not None:
            return unknown
        missing = self._missing(topic, seen, fact, now)
        if missing is not None:
            if fact.up_s < self._grace_s:
                return api.stale(
                    f"not seen yet, PHM has observed the graph for only {span(fact.up_s)}: {missing.summary}"
                )
            self._failed[topic.name] = missing.condition
            before = self._mismatched.get(topic.name)
            return before if before is not None and self._ends.being_recreated(full_name(topic.name), now) else missing
        self._mismatched.pop(topic.name, None)
        result = self._connected(topic, seen, fact, now)
        # Whatever was missing is there; the same condition at a lower level is the same measurement.
        if result.level is Level.WARN and result.condition != self._failed.get(topic.name):
            result = result.with_evidence(replace(result.evidence, recovered=True))
        elif result.level is not Level.WARN:
            self._failed[topic.name] = result.condition
        return result

    def _connected(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, now: float) -> api.Result:
        """The result while no endpoint is missing."""
        found = [*self._mismatches.find(topic, seen), *self._unfed(topic, seen, fact, now)]
        if found:
            worst = api.worst(found)
            if worst.evidence.conclusive and all_alive((*seen.publishers, *seen.subscribers), fact):
                worst = replace(worst, settle_s=SURE_S)
            self._mismatched[topic.name] = worst
            return worst
        return api.ok(
            f"Topic {api.topic_id(topic.name)} is connected: {_count(seen.publishers, 'publisher')}, "
            f"{_count(seen.subscribers, 'subscriber')}",
            values=numbers(seen),
        )

    def _missing(
        self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, now: float
    ) -> api.Result | None:
        """The first of: endpoint closed, topic missing, publisher missing, subscriber missing; last, a subscriber that is not needed now."""
        name = full_name(topic.name)
        # All of them in each run, which keeps the history of the endpoints.
        lost = [key for side in named_sides(topic, seen) for key in self._lost(name, *side, fact, now)]
        idle = [key for key in lost if key[1] == "subscriber" and use_of_output(key[2], fact) is Use.NONE]
        free = [node for _, _, node in idle]
        return (
            self._closed_endpoint(topic, seen, fact, now, [key for key in lost if key not in idle])
            or self._no_endpoint(topic, seen, fact)
            or self._named_missing(topic, seen, fact, free)
            or self._no_publisher(topic, seen, fact)
            or (on_demand(name, free) if free else None)
        )

    def _closed_endpoint(
        self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, now: float, lost: Sequence[Key]
    ) -> api.Result | None:
        if not lost:
            return None
        name, kind, node = lost[0]
        settles = [self._settle_s(key, fact, now) for key in lost]
        known = [settle_s for settle_s in settles if settle_s is not None]
        result = problem(
            topic,
            seen,
            Level.ERROR,
            f"{kind}_lost",
            f"lost {kind} {last(node)}"[:30],
            f"topic {name} has lost its {kind} {node}, which existed before and whose node is still running: it closed its "
            f"{'publisher' if kind == 'publisher' else 'subscription'}; check its log, restart it",
            self._homes.get(node, ""),
        )
        return replace(result, settle_s=max(known) if len(known) == len(settles) else None)

    def _settle_s(self, key: Key, fact: api.RosFact, now: float) -> float | None:
        """None: that of the unit."""
        settle_s = self._ends.settle_s(key, fact, now)
        if key[1] == "subscriber" and use_of_output(key[2], fact) is Use.OLD:
            return max(settle_s or SETTLE_S, OTHERS_S)
        return settle_s

    def _no_endpoint(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact) -> api.Result | None:
        if seen.publishers or seen.subscribers:
            return None
        return problem(
            topic,
            seen,
            Level.ERROR,
            "topic_missing",
            "missing",
            f"topic {full_name(topic.name)} does not exist, expected a publisher: check that its node is running and how it is remapped."
            f"{_hint(topic, fact, (*topic.publishers, *topic.subscribers), absent=True)}",
            self._target(topic),
        )

    def _named_missing(
        self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, free: Sequence[str]
    ) -> api.Result | None:
        """free: subscribers that need not be there now."""
        for kind, wanted, there in named_sides(topic, seen):
            names = {end.node for end in there}
            needed = [node for node in map(full_name, wanted) if kind == "publisher" or node not in free]
            lacking = [node for node in needed if node not in names]
            if lacking:
                hint = _hint(topic, fact, lacking) or did_you_mean(lacking[0], names)
                others = f"; present: {listed(sorted(names))}" if names else " and has no other"
                return problem(
                    topic,
                    seen,
                    Level.ERROR,
                    f"{kind}_missing",
                    f"lost {kind} {last(lacking[0])}"[:30],
                    f"topic {full_name(topic.name)} lacks its {kind} {listed(lacking)}{others}: check that node's topic names and remappings."
                    f"{hint}",
                    self._target(topic),
                )
        return None

    def _no_publisher(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact) -> api.Result | None:
        if seen.publishers:
            return None
        return problem(
            topic,
            seen,
            Level.ERROR,
            "publisher_missing",
            "has no publisher",
            f"topic {full_name(topic.name)} has no publisher, expected one: check that its node is running and how it is remapped."
            f"{_hint(topic, fact, ())}",
            self._target(topic),
        )

    def _lost(
        self,
        name: str,
        kind: str,
        wanted: Sequence[str],
        there: Sequence[api.EndpointFact],
        fact: api.RosFact,
        now: float,
    ) -> list[Key]:
        """Configured endpoints that existed earlier and whose node still runs."""
        names = {end.node for end in there}
        keys = [(name, kind, node) for node in map(full_name, wanted)]
        return [
            key
            for key in keys
            if self._ends.lost(key, there=key[2] in names, listed=bool(fact.nodes.get(key[2])), now=now)
        ]

    def _unfed(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, now: float) -> list[api.Result]:
        """WARN for a subscription without a publisher on a similar name: most likely a misspelling of this topic."""
        name = full_name(topic.name)
        found = [stray for stray in similar_names(name, fact.others) if stray.sure and stray.unfed]
        since = self._stray_since.setdefault(name, now) if found else self._stray_since.pop(name, now)
        if not found or now - since < STRAY_S or fact.up_s < self._grace_s:
            return []
        hints = joined([sentence(name, stray) for stray in found[:SHOWN]])
        return [
            problem(
                topic,
                seen,
                Level.WARN,
                "name_mistaken",
                f"misnamed {found[0].name[-21:]}",
                f"topic {name} is connected, but {hints} Nothing publishes that name: correct it in that node's source, launch file "
                "or remappings",
                self._target(topic),
            )
        ]

    def _target(self, topic: api.TopicSettings) -> str:
        return self._targets[unit_id(topic)]


def _hint(topic: api.TopicSettings, fact: api.RosFact, lacking: Iterable[str], *, absent: bool = False) -> str:
    """Sentences about similar names that may be the missing topic: names used by a missing node, or on one side only.

    `absent`: the configured name does not exist in the graph, so every similar name is mentioned.
    """
    name = full_name(topic.name)
    similar = similar_names(name, fact.others)
    theirs = [stray for stray in similar if stray.used_by([full_name(node) for node in lacking])]
    likely = theirs or [stray for stray in similar if absent or (stray.sure and stray.one_sided)]
    return "".join(f" {sentence(name, stray)}" for stray in likely[:SHOWN])


def _count(ends: Sequence[api.EndpointFact], what: str) -> str:
    return f"{len(ends)} {what}" if len(ends) == 1 else f"{len(ends)} {what}s"
