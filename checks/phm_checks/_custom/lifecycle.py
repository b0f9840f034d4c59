"""Type `lifecycle`: a ROS 2 lifecycle node is in the expected state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phm import api
from phm_checks._custom.base import Finding, bad, good
from phm_checks._custom.ros import RosCheck
from phm_checks._readiness import Requirements
from phm_checks._ros_facts import full_name, snapshot


class Lifecycle(RosCheck):
    """The rules are those of `ros.nodes[].ready.lifecycle`. A dead node is one fault."""

    @property
    def node(self) -> str:
        return full_name(self.entry.node)

    @property
    def units(self) -> Sequence[api.Unit]:
        (unit,) = super().units
        return (replace(unit, needs=(*unit.needs, f"nodes/{api.topic_id(self.node)}")),)

    def observe(self, world: api.World) -> Finding:
        fact, node, state = snapshot(world), self.node, self.entry.state
        found = Requirements(fact, self.settings.ros).lifecycle(node, state)
        if found is None:
            return good(f"{node} is {state}", state=state)
        if found.unknown:
            raise api.CannotTell(f"state of {node} unknown: {found.words}")
        return replace(bad(f"{node}: {found.words}", found.short), unanswered=found.unanswered)
