"""Routine messages leave room in the link's budget: a new fault and an answer to a command do not wait for them."""

from __future__ import annotations

from functools import cache

import pytest

from phm.commands import responses
from phm.core.model import Level, Transition
from phm.reporters.swarm import VIEW_HEARTBEATS
from phm.testing import FakeClock
from phm.transport.dialect import mavlink
from phm.transport.priority import SWARM_BYTES_S, MessagePriority, default_periods
from phm.transport.send_queue import SendQueue
from phm.wire import tunnel
from phm.wire.command import Command, CommandResult
from sitl.simulation.fleet import Agent, Fleet
from tests.fakes.mavlink import heartbeat, text

SIGNATURE = 13
STATUSTEXT, COMMAND_ACK = 13, 22
"""Bytes of a STATUSTEXT without its text, and of a COMMAND_ACK."""
VIEWS = {8: 23, 30: 28, 100: 46}
"""Bytes of a view by the number of agents."""
COMMAND = Command(31010, (2, 17), 0, 254, 190, "mesh", signed=True)


@pytest.fixture(autouse=True)
def decode_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All agents are in one process and receive the same bytes: only the first decodes them."""
    monkeypatch.setattr(tunnel, "decode", cache(tunnel.decode))


def sign(agent: Agent) -> None:
    """Count each message as large as a signed one."""
    size = agent.port.codec.size
    agent.port.codec.size = lambda message: size(message) + SIGNATURE  # type: ignore[method-assign]


def fail(agent: Agent, unit: str, brief: str) -> None:
    old = agent.units[unit].level
    agent.become(unit, Level.ERROR, brief)
    agent.reporters[0].handle(Transition(agent.clock.stamp(), old, agent.units[unit]))


@pytest.mark.parametrize("failing", [False, True])
def test_a_full_swarm_with_signing_has_room_for_a_fault_and_an_answer(failing: bool) -> None:
    """Eight agents, whose routine messages need more than their share, after 15 minutes."""
    fleet = Fleet(8, step_s=1.0)
    for one in fleet.agents.values():
        sign(one)
    agent = fleet.agents[5]
    fleet.run(60)
    if failing:
        fail(agent, "container/app", "ros_app exited with code 137")
    fleet.run(840)
    fleet.lines()
    fail(agent, "nodes/a", "node_1 dead")
    agent.port.send(responses.ack(COMMAND, CommandResult.ACCEPTED), MessagePriority.REQUEST, key="ack")
    fleet.run(1)
    assert fleet.lines(3) == ["A05 FAIL 6 node_1 dead"]
    fleet.run(1)
    assert agent.port.bytes_by["COMMAND_ACK"]


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("characters", [15, 50])
@pytest.mark.parametrize("agents", [8, 30, 100])
def test_routine_messages_alone_never_use_up_the_budget(agents: int, characters: int, signed: bool) -> None:
    """Two hours with the refresh of a healthy agent, or the longest one; then a fault and an answer, both in the same
    second.
    """
    clock = FakeClock()
    queue = SendQueue(clock, SWARM_BYTES_S)
    queue.set_agent_count(agents, leads=False)
    heartbeat_s, refresh_s = default_periods(agents)
    extra = SIGNATURE if signed else 0
    sent = 0
    for second in range(7200):
        if second % heartbeat_s == 0:
            queue.put(heartbeat(5), 21 + extra)
        if second % (VIEW_HEARTBEATS * heartbeat_s) == 0:
            queue.put(view(), VIEWS[agents] + extra, MessagePriority.SWARM, "view")
        if second % refresh_s == 0:
            queue.put(text("refresh"), STATUSTEXT + characters + extra, MessagePriority.REFRESH, "refresh", 6)
        clock.advance(1.0)
        sent += sum(item.kind is MessagePriority.REFRESH for item in iter(queue.take, None))
    assert sent >= 7200 / refresh_s / 4  # rarer, but they do not end
    queue.put(text("fault"), STATUSTEXT + 24 + extra, MessagePriority.TRANSITION, "fault", 2)
    queue.put(responses.ack(COMMAND, CommandResult.ACCEPTED), COMMAND_ACK + extra, MessagePriority.REQUEST, "ack")
    assert {item.key for item in iter(queue.take, None)} >= {"fault", "ack"}


def view() -> object:
    return mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, 0, [0] * 128)
