"""A fault of one node of the demo application, by a signal of `sitl.application.behaviour`."""

from __future__ import annotations

from typing import ClassVar

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class NodeSignal(Fault):
    """Sends the signal to node_1; a restart of the application ends its effect. signal_number: as text."""

    signal_number: ClassVar[str]

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", self.signal_number)

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
