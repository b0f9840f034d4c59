"""Routine messages leave room in the link's budget: a new fault and an answer to a command do not wait for them."""

from __future__ import annotations

from functools import cache

import pytest

from phm.commands import responses
from phm.core.model import Level, Transition
from phm.reporters.swarm import VIEW_HEARTBEATS
from phm.testing import FakeClock
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.priority import SWARM_BYTES_S, MessagePriority, default_periods
from phm.transport.send_queue import SendQueue
from phm.wire import tunnel
from phm.wire.command import Command, CommandResult
from sitl.simulation.fleet import Agent, Fleet
from tests.fakes.mavlink import heartbeat, text
from tests.reporters.test_mavlink import Scene

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


class Changing:
    """A signing agent of a swarm with one unit whose text is a new one each second."""

    def __init__(self, agents: int) -> None:
        self.scene = Scene(agent=5)
        self.scene.port.agents = agents
        self.queue, codec = SendQueue(self.scene.clock, SWARM_BYTES_S), Codec(5, 193, lambda _: False)
        self.queue.set_agent_count(agents, leads=False)
        self.scene.port.to = lambda message, kind, key, urgency: self.queue.put(
            message, codec.size(message) + SIGNATURE, kind, key, urgency
        )
        self.view_s, self.view_bytes = VIEW_HEARTBEATS * default_periods(agents)[0], VIEWS[agents] + SIGNATURE
        self.second = 0
        self.scene.running()

    def pass_seconds(self, seconds: int) -> set[tuple[str, MessagePriority]]:
        """Key and priority of what left within them."""
        left = set()
        for _ in range(seconds):
            self.second += 1
            if self.second % self.view_s == 0:
                self.queue.put(view(), self.view_bytes, MessagePriority.SWARM, "view")
            self.scene.become("nodes/a", Level.ERROR, f"node_1 waits {self.second} s for the other nodes")
            self.scene.clock.advance(1.0)
            self.scene.reporter.tick()
            left |= {(item.key, item.kind) for item in iter(self.queue.take, None)}
        return left


@pytest.mark.parametrize("agents", [30, 100])
def test_a_text_that_changes_each_second_leaves_room_for_everything_else(agents: int) -> None:
    """After 20 minutes the full state, an answer and another fault leave immediately; then its texts and the routine
    messages take turns.
    """
    agent = Changing(agents)
    agent.pass_seconds(1200)
    agent.scene.reporter.gcs_appeared()
    agent.queue.put(
        responses.ack(COMMAND, CommandResult.ACCEPTED), COMMAND_ACK + SIGNATURE, MessagePriority.REQUEST, "ack"
    )
    assert agent.pass_seconds(2) >= {("nodes/a", MessagePriority.STATE), ("ack", MessagePriority.REQUEST)}
    agent.scene.become("host", Level.ERROR, "disk / 99 %")
    assert ("host", MessagePriority.TRANSITION) in agent.pass_seconds(1)
    for _ in range(3):
        left = agent.pass_seconds(3600)
        assert left == {
            ("nodes/a", MessagePriority.REFRESH),
            ("refresh", MessagePriority.REFRESH),
            ("view", MessagePriority.SWARM),
            ("", MessagePriority.TRANSITION),  # heartbeats
        }


def view() -> object:
    return mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, 0, [0] * 128)


@pytest.mark.long
def test_an_agent_whose_phm_restarts_again_and_again_leaves_room_for_the_others() -> None:
    """Each restart asks all others for their views, but not more often than they have room for."""
    fleet = Fleet(30, step_s=1.0)
    fleet.run(180)
    before = fleet.agents[6].port.sent_keys["view"]
    reporter = fleet.agents[5].reporters[0]
    for _ in range(30):
        refresh_at, reporter._refresh_at = reporter._refresh_at, None  # type: ignore[union-attr]  # it says BOOT
        fleet.run(5)
        reporter._refresh_at = refresh_at  # type: ignore[union-attr]
        fleet.run(15)
    assert fleet.agents[6].port.sent_keys["view"] - before < 30
