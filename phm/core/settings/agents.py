"""Sections `agent` and `swarm`."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from phm.core.settings.base import Name, Section


def _not_a_radio(value: int) -> int:
    if value == 51:
        raise ValueError("51 is the system id of SiK radios: choose another of 1 to 250")
    return value


AgentId = Annotated[int, Field(ge=1, le=250), AfterValidator(_not_a_radio)]


class AgentSettings(Section):
    """Identity of this agent."""

    name: Name = "agent_1"
    """Name of the agent, in logs and displays."""
    id: AgentId = 1
    """Number in the swarm, 1 to 250 but not 51 (taken by SiK radios); the vehicle's MAVLink system id."""


class SwarmSettings(Section):
    """The other agents, received over MAVLink."""

    agents: list[AgentId] = Field(default_factory=list, max_length=250)
    """Ids of all agents of the swarm; one that is not received is reported as missing. Default: all agents ever received."""
