"""The child's participant, the graph that it sees, and a monitor for each topic with a rate.

Importing this module raises ImportError without rclpy.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from phm.facts.ros import RateFact, TopicFact
from phm.probes.ros.beacons import BeaconListener
from phm.probes.ros.diagnostics import DiagnosticsListener
from phm.probes.ros.graph import OWN_NODE_PREFIX, GraphReader
from phm.probes.ros.graph_comparison import Known, SecondParticipant
from phm.probes.ros.graph_events import GraphEvents
from phm.probes.ros.graph_snapshot import findings, flow
from phm.probes.ros.protocol import GraphMessage, Message, OtherTopics, Publish, Tick, Wanted
from phm.probes.ros.rates.topic_monitor import TopicMonitor
from phm.probes.ros.raw_names import printable
from phm.probes.ros.readiness import ReadinessReader
from phm.probes.ros.self_reports import ConfiguredNames
from phm.probes.ros.unconfigured_topics import UnconfiguredTopics


class Observer:
    """One poll per tick; nothing in it blocks."""

    def __init__(self, wanted: Wanted, number: int = 0) -> None:
        """`number`: that of the last graph message of an earlier observer."""
        self._wanted = wanted
        self.known: Known = frozenset()
        """The configured nodes and endpoints found at the last poll."""
        self._context, self._node = _participant(wanted, wanted.agent)
        self._began_s = time.monotonic()
        self._graph = GraphReader(self._node, [topic.name for topic in wanted.topics], wanted.full_s, wanted.nodes)
        self._gauges = {
            topic.name: TopicMonitor(self._node, topic, wanted.tick_s)
            for topic in wanted.topics
            if topic.rate_hz is not None
        }
        self._names = UnconfiguredTopics(self._node, {topic.name for topic in wanted.topics})
        self._diagnostics = DiagnosticsListener(
            self._node, wanted.listen, ConfiguredNames(statuses=wanted.watch).is_status
        )
        self._beacons = BeaconListener(self._node, frozenset(wanted.nodes))
        self._readiness = ReadinessReader(self._node, wanted)
        self._events = GraphEvents(self._node, self._context)
        self._full_s = wanted.full_s
        self._next_full_s = 0.0
        self._number = number
        self._states: Mapping[str, object] = {}

    @property
    def events(self) -> int | None:
        """A descriptor that is readable when the graph may have changed; None without events."""
        return self._events.fd

    def poll(self, *, notified: bool = False, late_s: float = 0.0) -> list[Message]:
        """Return the messages for the daemon; called once per tick. notified: `events` was readable. late_s: delay of the call.

        The graph message comes last, so that the daemon has everything needed to evaluate it.
        """
        if notified:
            self._events.take()
        message = self._graph_message(notified=notified, late_s=round(late_s, 3))
        reports = [
            *self._beacons.poll(),
            *self._diagnostics.poll(),
            *self._readiness.poll(time.monotonic(), graph_changed=isinstance(message, GraphMessage)),
        ]
        return [*reports, *self._others(), message]

    @property
    def lacking(self) -> bool:
        """Whether a configured node is not listed, or a topic with a rate has no publisher."""
        return not self._graph.nodes.keys() >= set(self._wanted.nodes) or any(
            not self._graph.publishers[name] for name in self._gauges
        )

    def second(self) -> SecondParticipant:
        """A second participant that observes the same graph."""
        return _GraphParticipant(self._wanted)

    def renewed(self) -> Observer:
        """Close this observer and return a new one with a new participant and an empty graph."""
        self.close()
        return Observer(self._wanted, self._number)

    def execute(self, order: Publish) -> None:
        """Execute an order of the daemon."""
        self._diagnostics.publish(order)

    def _others(self) -> list[Message]:
        """The unconfigured topics after a change. They only help to find misspelt names: rates and beacons must continue."""
        try:
            return [OtherTopics(self._names.names)] if self._names.observe(time.monotonic()) else []
        except Exception as error:  # whatever rclpy and rcl raise
            self._names.problem = printable(f"the names of other topics cannot be read: {error}")
            return []

    def _graph_message(self, *, notified: bool, late_s: float) -> GraphMessage | Tick:
        """A GraphMessage after a change or when one is due, else a Tick."""
        now_s = time.monotonic()
        changed = self._graph.poll(now_s, notified=notified)
        if changed:
            self.known = _known(self._graph)
        rates: dict[str, RateFact] = {}
        for name, gauge in self._gauges.items():
            rates[name] = gauge.poll(now_s, self._graph.publishers[name])
        data = {name: gauge.data for name, gauge in self._gauges.items()}
        states = {name: (flow(rate), findings(data[name])) for name, rate in rates.items()}
        up_s = round(now_s - self._began_s, 3)
        if not changed and states == self._states and now_s < self._next_full_s:
            return Tick(up_s, {name: rate.silent_s for name, rate in rates.items()}, self._number, late_s)
        self._states = states
        self._next_full_s = now_s + self._full_s
        graph = self._graph
        topics = {
            name: TopicFact(publishers, graph.subscribers[name], rates.get(name), data.get(name))
            for name, publishers in graph.publishers.items()
        }
        self._number += 1
        problems = tuple(filter(None, (*graph.problems, self._names.problem)))
        idle = self._diagnostics.idle()
        return GraphMessage(up_s, graph.nodes, topics, self._number, graph.names_known, problems, late_s, idle)

    def close(self) -> None:
        """Leave the graph, so that other participants remove this one immediately and not after its lease."""
        self._events.close()
        self._diagnostics.close()
        self._node.destroy_node()
        self._context.try_shutdown()


class _GraphParticipant:
    """A participant that reads only the graph."""

    def __init__(self, wanted: Wanted) -> None:
        self._context, self._node = _participant(wanted, f"{wanted.agent}_second")
        self._graph = GraphReader(self._node, [topic.name for topic in wanted.topics], wanted.full_s, wanted.nodes)

    def known(self, now_s: float) -> Known:
        self._graph.poll(now_s)
        return _known(self._graph)

    def close(self) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()


def _participant(wanted: Wanted, name: str) -> tuple[Any, Any]:
    """A context with one hidden node."""
    context: Any = Context()
    # Without logging set up rcl creates no log directory: the sidecar's file system is read-only.
    context.init(args=[], initialize_logging=False, domain_id=wanted.domain)
    node: Any = Node(
        OWN_NODE_PREFIX + re.sub(r"\W", "_", name, flags=re.ASCII),
        context=context,
        start_parameter_services=False,
        enable_rosout=False,
        use_global_arguments=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )
    return context, node


def _known(graph: GraphReader) -> Known:
    """Of unconfigured nodes only the relation to a configured topic: others must not keep PHM busy."""
    nodes = {(name,) for name in graph.nodes if name in graph.configured}
    sides = {"publisher": graph.publishers, "subscriber": graph.subscribers}
    return frozenset(nodes) | {
        (topic, side, end.node) for side, ends in sides.items() for topic in ends for end in ends[topic] if end.node
    }
