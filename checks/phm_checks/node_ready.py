"""Slot 6: each node with `ready` is in its lifecycle state and has its services and topics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._readiness import Requirements, Subject
from phm_checks._ros_facts import full_name, snapshot
from phm_checks._text import clean

STARTING = frozenset({"unconfigured", "configuring"})
"""Lifecycle states in which a node is after a start. PHM does not see all of them: a transition may be short."""


@dataclass(slots=True)
class _Start:
    """Whether a node that was ready has been started again, and has not been ready since."""

    was_ready: bool = False
    again: bool = False

    def observe(self, state: str, *, ready: bool) -> bool:
        if ready:
            self.was_ready, self.again = True, False
        elif self.was_ready and state in STARTING:
            self.was_ready, self.again = False, True
        return self.again


class NodeReady(api.Check):
    """All nodes with `ready`, one unit each. They need the unit of their node: a dead node is one fault."""

    name, slot, layer = "node_ready", Slot.NODES, Layer.ROS
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._settings = settings
        self._subjects: dict[str, Subject] = {}
        self._states: dict[str, str | None] = {}
        for entry in settings.ros.nodes:
            node = full_name(entry.name)
            if entry.ready is not None:
                unit = f"{self.name}/{api.topic_id(node)}"
                self._subjects[node] = Subject(unit, f"node {node}", entry.ready, settings.container_of_node(node))
                self._states[node] = entry.ready.lifecycle
        self._starts = {node: _Start() for node in self._subjects}

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if any(node.ready is not None for node in settings.ros.nodes) else []

    @property
    def units(self) -> Sequence[api.Unit]:
        units = {
            node: one.as_unit([f"nodes/{api.topic_id(node)}"], self._settings) for node, one in self._subjects.items()
        }
        return [replace(unit, node=node) for node, unit in units.items()]

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each node; STALE for all without recent data from the ROS child process."""
        try:
            fact = snapshot(world)
        except api.CannotTell as reason:
            return {one.unit: api.stale(str(reason)) for one in self._subjects.values()}
        required = Requirements(fact, self._settings.ros)
        return {one.unit: self._judge(node, one, required, fact) for node, one in self._subjects.items()}

    def _judge(self, node: str, subject: Subject, required: Requirements, fact: api.RosFact) -> api.Result:
        expected, state = self._states[node], clean(fact.lifecycle.get(node, api.AnswerFact()).answer, 20)
        found = required.unmet(subject.ready)
        if expected is not None and (wrong := required.lifecycle(node, expected)) is not None:
            found.insert(0, wrong)
        if expected is None:
            return subject.result(found, "Check its log")
        result = subject.result(
            found, f"Check its log, and what activates it; `ros2 lifecycle get {node}` shows the state", lifecycle=state
        )
        starts = self._starts[node].observe(state, ready=result.level is Level.OK)
        return replace(result, settle_s=subject.ready.within) if starts and result.level.bad else result
