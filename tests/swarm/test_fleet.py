"""Entire swarms with the real probe, reporters and budgets: which agent leads, what the ground receives, what it costs."""

from __future__ import annotations

from functools import cache

import pytest

from phm.core.model import Level
from phm.transport.dialect import mavlink
from phm.transport.priority import RADIO_BYTES_S, SWARM_BYTES_S
from phm.wire import tunnel
from sitl.simulation.fleet import Agent, Fleet
from tests.fakes.mavlink import Sender, heartbeat


@pytest.fixture(autouse=True)
def decode_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All agents are in one process and receive the same bytes: only the first of a hundred decodes them."""
    monkeypatch.setattr(tunnel, "decode", cache(tunnel.decode))


def test_one_agent_leads_and_its_line_is_not_repeated() -> None:
    """All agents agree on the lowest one, and its line is no more than INFO while all are OK."""
    fleet = Fleet(8)
    fleet.run(60)
    assert {agent.probe.snapshot().leader for agent in fleet.agents.values()} == {1}
    assert fleet.lines(5) == []
    fleet.run(20)
    assert {text for text in fleet.lines() if text.startswith("SWARM")} == {"SWARM 8/8 OK"}


def test_a_lost_leader_is_replaced_and_reported() -> None:
    """By the next lowest agent, whose line names it."""
    fleet = Fleet(8)
    fleet.run(60)
    fleet.lines()
    fleet.down = {1}
    fleet.run(40)
    assert {fleet.agents[number].probe.snapshot().leader for number in range(2, 9)} == {2}
    assert "SWARM 7/8 FAIL A01:lost" in fleet.lines()


def test_an_agent_without_its_ground_radio_is_reported_by_its_peers() -> None:
    """Its own lines do not reach the ground; its status word reaches its peers."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    assert "A03 no GCS radio, received by A01 A02 A04: OK" in fleet.lines(4)
    fleet.agents[3].become("container/app", Level.ERROR, "app exited")
    fleet.run(20)
    assert fleet.lines(3) == ["A03 no GCS radio, received by A01 A02 A04: 2 ERROR"]
    fleet.run(60)
    assert fleet.lines(4) == []


def test_a_new_leader_repeats_no_alarm() -> None:
    """Nothing has changed for A03; the previous leader had reported it to the ground."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    fleet.lines()
    fleet.down = {1}
    fleet.run(60)
    assert fleet.agents[2].probe.snapshot().leader == 2
    assert fleet.lines(4) == []


def test_unreported_changes_of_a_lost_leader_are_reported_by_the_next() -> None:
    """A03 fails at the moment the leader dies."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    fleet.lines()
    fleet.down = {1}
    fleet.agents[3].become("container/app", Level.ERROR, "app exited")
    fleet.run(60)
    assert [line.partition(",")[0] for line in fleet.lines(4)] == ["A03 no GCS radio"]


def test_a_new_ground_station_receives_relayed_agents_again() -> None:
    """As each agent sends its full state, the leader does so for agents that cannot."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    fleet.lines()
    for _ in range(3):
        hello = Sender(254, 190).received(heartbeat(kind=mavlink.MAV_TYPE_GCS))
        for number in (1, 2, 4):
            fleet.agents[number].port.receive([hello])
        fleet.run(5)
    assert fleet.lines(4) == ["A03 no GCS radio, received by A01 A02 A04: OK"]


def test_stations_that_appear_all_the_time_do_not_fill_the_leaders_link() -> None:
    """Their lines would be changes, which leave no room for those of a fault. They are no sign that an agent flaps."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    fleet.lines()
    before = fleet.agents[1].port.sent_keys["swarm line"]
    for number in range(300):
        hello = Sender(200 + number % 50, 190).received(heartbeat(kind=mavlink.MAV_TYPE_GCS))
        fleet.agents[1].port.receive([hello])
        fleet.run(1)
    assert fleet.agents[1].port.sent_keys["swarm line"] - before < 70
    assert set(fleet.lines(5)) == {"A03 no GCS radio, received by A01 A02 A04: OK"}


def test_a_ground_station_that_appears_is_not_a_failure_of_others() -> None:
    """Each agent knows that it receives the station before it knows that of the others. A lost radio is reported then."""
    fleet = Fleet(8)
    fleet.no_gcs = set(fleet.agents)
    fleet.run(60)
    fleet.no_gcs = {3}
    fleet.run(30)
    sent = [(agent, text.partition(",")[0]) for agent, severity, text in fleet.ground if severity <= 4]
    assert sent == [(1, "A03 no GCS radio")]
    assert {agent for agent, _, text in fleet.ground if text.startswith("SWARM")} == {1}
    assert {agent.probe.snapshot().leader for agent in fleet.agents.values()} == {1}


def test_a_started_agent_has_not_lost_the_ground() -> None:
    """It receives its peers before the ground station's first heartbeat."""
    fleet = Fleet(8)
    fleet.run(60)
    fleet.lines()
    fleet.agents[5] = Agent(5, fleet.clock, list(fleet.agents), 158.0)
    fleet.no_gcs = {5}
    fleet.run(2.5)
    fleet.no_gcs = set()
    fleet.run(10)
    assert fleet.lines(4) == []


def test_an_agent_at_the_edge_of_radio_range_is_not_reported_each_time() -> None:
    """It loses and regains the ground every 15 s, and fails and recovers meanwhile."""
    fleet = Fleet(4)
    fleet.run(60)
    fleet.no_gcs = {3}
    fleet.run(20)
    fleet.lines()
    for turn in range(40):
        fleet.agents[3].become("container/app", Level.OK if turn % 2 else Level.ERROR, "app exited")
        fleet.run(6)
    received = fleet.lines(5)
    assert "A03 no GCS radio: flapping" in received
    assert len(received) < 10
    fleet.run(60)
    assert len(fleet.lines(5)) <= 1


def test_views_list_the_agents_that_an_agent_receives() -> None:
    """The ground, the autopilot and the radio; a change is sent immediately."""
    fleet = Fleet(2)
    fleet.run(30)

    def view() -> tuple[bool, bool, bool]:
        peer = fleet.agents[1].probe._peers.peer(2)
        assert peer is not None
        assert peer.view is not None
        return peer.view.gcs, peer.view.autopilot, peer.view.radio

    assert view() == (True, True, False)
    fleet.agents[2].radio = True
    fleet.run(3)
    assert view() == (True, True, True)


def test_the_leader_stops_relaying_when_a_radio_returns() -> None:
    """The line no longer names the agent."""
    fleet = Fleet(4)
    fleet.no_gcs = {3}
    fleet.run(60)
    fleet.no_gcs = set()
    fleet.run(30)
    assert fleet.agents[1].probe.snapshot().no_gcs == ()
    fleet.lines()
    fleet.run(20)
    assert "SWARM 4/4 OK" in fleet.lines()


def test_both_sides_of_a_split_have_their_own_leader() -> None:
    """One leader again after its end."""
    fleet = Fleet(6)
    fleet.run(60)
    fleet.cut = {pair for a in (1, 2) for b in (3, 4, 5, 6) for pair in ((a, b), (b, a))}
    fleet.run(60)
    assert fleet.agents[1].probe.snapshot().split == (3, 4, 5, 6)
    assert fleet.agents[6].probe.snapshot().split == (1, 2)
    assert (fleet.agents[2].probe.snapshot().leader, fleet.agents[6].probe.snapshot().leader) == (1, 3)
    fleet.cut = set()
    fleet.run(60)
    assert {agent.probe.snapshot().leader for agent in fleet.agents.values()} == {1}
    assert {agent.probe.snapshot().living for agent in fleet.agents.values()} == {6}


def test_a_split_is_detected_before_single_agents_are_lost() -> None:
    """Five minutes in, with heartbeats at different times: a cut agent and both halves of a split detect it within 3.5
    s, and never report a single agent as lost before.
    """
    fleet = Fleet(8)
    for number, agent in fleet.agents.items():
        agent.reporters[0]._heartbeat_at += 3 * number % 8 / 4  # type: ignore[union-attr]
    fleet.run(300)
    halves = [{1, 2, 3, 4}, {5, 6, 7, 8}]
    for groups in ([{8}, {1, 2, 3, 4, 5, 6, 7}], halves):
        fleet.cut = {(a, b) for one in groups for other in groups if one is not other for a in one for b in other}
        sides = [group for group in groups if 2 * len(group) <= 8]
        for _ in range(14):
            fleet.run(0.25)
            for number, agent in fleet.agents.items():
                away = next(other for other in groups if number not in other)
                lost = {other for other, peer in agent.probe.snapshot().peers.items() if peer.state == "lost"}
                assert lost in (set(), away)
        for side in sides:
            for number in side:
                fact = fleet.agents[number].probe.snapshot()
                assert set(fact.split) == set(fleet.agents) - side
                assert fact.leader == (min(side) if len(side) > 1 else None)
        fleet.run(20)  # as long as no fade lasts
        fleet.cut = set()
        fleet.run(60)
        assert {agent.probe.snapshot().living for agent in fleet.agents.values()} == {8}


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_no_agent_is_lost_in_a_lossy_network(loss: float) -> None:
    """Ten minutes with a tenth of all frames lost: consensus never declares an agent lost."""
    fleet = Fleet(8, loss=loss)
    lost = set()
    for _ in range(60):
        fleet.run(10)
        lost |= {
            number
            for agent in fleet.agents.values()
            for number, peer in agent.probe.snapshot().peers.items()
            if peer.state == "lost"
        }
    assert lost == set()


@pytest.mark.parametrize("count", [1, 8, 30])
def test_an_idle_swarm_stays_within_its_share(count: int) -> None:
    """All frames of all agents on one link, over two or more periods of each message, once the savings of the start are used."""
    fleet = Fleet(count, step_s=0.25 if count < 30 else 1.0)
    fleet.run(180)
    assert bytes_s(fleet, 200) <= SWARM_BYTES_S


@pytest.mark.long
def test_a_hundred_agents_agree_and_stay_within_six_percent() -> None:
    """A hundred agents, three die, one loses its radio: all live ones agree, the ground gets it in one line."""
    fleet = Fleet(100, step_s=1.0)
    fleet.run(80)
    assert {agent.probe.snapshot().living for agent in fleet.agents.values()} == {100}
    assert bytes_s(fleet, 60) <= 0.06 * RADIO_BYTES_S
    fleet.down, fleet.no_gcs = {5, 50, 95}, {7}
    fleet.lines()
    fleet.run(105)
    living = {agent.probe.snapshot().living for number, agent in fleet.agents.items() if number not in fleet.down}
    assert living == {97}
    lines = fleet.lines()
    assert "SWARM 96/100 FAIL A05:lost A50:lost A95:lost +1" in lines
    assert any(line.startswith("A07 no GCS radio, received by A01 A02") for line in lines)


def bytes_s(fleet: Fleet, seconds: float) -> float:
    """What all agents send per second, over this many seconds of the fleet's clock."""
    before = sum(agent.port.bytes_out for agent in fleet.agents.values())
    fleet.run(seconds)
    return (sum(agent.port.bytes_out for agent in fleet.agents.values()) - before) / seconds
