"""What the ground station derives from frames: agents, their state, broken hops, and what is unknown."""

from __future__ import annotations

import json

import pytest

from phm.core.model import Level, Slot
from phm.gcs.agent import MAX_BAD
from phm.gcs.events import encode
from phm.gcs.frames import Heartbeat, TunnelPayload, parse
from phm.transport.dialect import mavlink
from phm.wire import tunnel
from phm.wire.tunnel import PeerState, PeerView
from tests.fakes.mavlink import Sender
from tests.gcs.bench import EMERGENCY, HEALTHY, Ground, autopilot, events, phm_heartbeat, text_frame, tunnel_frame


@pytest.fixture
def ground() -> Ground:
    return Ground()


# ---------------------------------------------------------------- known agents


def test_an_unlisted_agent_is_discovered_by_its_heartbeat(ground: Ground) -> None:
    """One event for the agent and one for its slots; an equal heartbeat causes none."""
    news = ground.receive(phm_heartbeat(9, {Slot.NODES: Level.ERROR}, state=EMERGENCY))
    assert [one.event for one in news] == ["agent", "slots"]
    assert events(news, "agent")[0]["name"] == "A09"
    agent = ground.agent(9)
    assert (agent["how"], agent["presence"], agent["state"]) == ("ERROR", "alive", "EMERGENCY")
    assert agent["slots"] == {**{str(int(slot)): "OK" for slot in HEALTHY}, "6": "ERROR"}
    assert ground.receive(phm_heartbeat(9, {Slot.NODES: Level.ERROR}, state=EMERGENCY)) == []


def test_unreported_state_is_unknown() -> None:
    """An expected agent that was never received, one that has not reported its slots, and slots that it omits."""
    ground = Ground(expected=(3,))
    agent = ground.agent(3)
    assert (agent["how"], agent["presence"], agent["slots"], agent["age_s"]) == ("UNKNOWN", "never received", {}, None)
    assert (agent["line"], agent["autopilot"], agent["receives_ground"], agent["period_s"]) == (None, None, None, None)
    ground.receive(Heartbeat(3, 193, 18, 8, 0, 1 << 30, 4))
    assert (ground.agent(3)["how"], ground.agent(3)["slots"]) == ("UNKNOWN", {})
    ground.receive(phm_heartbeat(3, {Slot.FILES: Level.STALE}))
    assert "3" not in ground.agent(3)["slots"]


@pytest.mark.parametrize(
    "frame",
    [
        Heartbeat(9, 191, 18, 8, 0, 0, 4),
        Heartbeat(9, 191, 18, 8, 0, 7, 4),
        Heartbeat(9, 1, 2, 3, 0, 1 << 30, 4),
        Heartbeat(0, 193, 18, 8, 0, 1 << 30, 4),
        Heartbeat(251, 193, 18, 8, 0, 1 << 30, 4),
        Heartbeat(9, 193, 6, 8, 0, 1 << 30, 4),
        Heartbeat(254, 190, 18, 8, 0, 1 << 30, 4),
    ],
    ids=["no word", "a mode", "an autopilot", "id 0", "id 251", "a ground station", "ourselves"],
)
def test_heartbeats_of_others_make_no_agent(ground: Ground, frame: Heartbeat) -> None:
    """Regardless of their custom_mode."""
    ground.receive(frame)
    assert ground.snapshot()["agents"] == []


def test_a_status_word_of_another_version_is_reported_as_unreadable(ground: Ground) -> None:
    """Once; the agent is listed, and its slots are unknown."""
    news = ground.receive(Heartbeat(9, 193, 18, 8, 0, 2 << 30 | 1, 4))
    assert "version 2" in events(news, "problem")[0]["text"]
    assert ground.receive(Heartbeat(9, 193, 18, 8, 0, 2 << 30 | 1, 4)) == []
    assert (ground.agent(9)["how"], ground.agent(9)["slots"]) == ("UNKNOWN", {})


def test_two_phms_of_one_vehicle_are_two_rows(ground: Ground) -> None:
    """A second PHM on another component does not hide the first."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(7, {Slot.FILES: Level.ERROR}, component=195))
    assert [(one["name"], one["how"]) for one in ground.snapshot()["agents"]] == [("A07", "OK"), ("A07/195", "ERROR")]


# ---------------------------------------------------------------- what was reported last


def test_a_line_counts_until_the_next_heartbeat(ground: Ground) -> None:
    """A failure or its end is known by whichever is received first."""
    ground.receive(phm_heartbeat(7), text_frame(7, "A07 FAIL 6 node_1 dead"))
    assert (ground.agent(7)["how"], ground.agent(7)["slots"]["6"]) == ("ERROR", "ERROR")
    ground.receive(text_frame(7, "A07 FAIL 6 node_2 dead"), text_frame(7, "A07 OK 6 node_1 restarted", 5))
    assert ground.agent(7)["how"] == "ERROR"
    ground.receive(text_frame(7, "A07 OK 6 node_2 restarted", 5))
    assert (ground.agent(7)["how"], ground.agent(7)["slots"]["6"]) == ("OK", "OK")
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}))
    assert ground.agent(7)["how"] == "ERROR"


def test_a_heartbeat_that_contradicts_a_line_is_an_event(ground: Ground) -> None:
    """Also if its word is the last one: PHM restarted the node between two heartbeats, and the line about it was lost."""
    ground.receive(phm_heartbeat(7), text_frame(7, "A07 FAIL 6 node_1 dead"))
    changed = [body["changed"] for body in events(ground.receive(phm_heartbeat(7)), "slots")]
    assert changed == [{"6": ["ERROR", "OK"]}]
    assert ground.receive(phm_heartbeat(7)) == []


def test_the_end_of_an_unknown_failure_proves_nothing(ground: Ground) -> None:
    """The heartbeat says ERROR, and the lines about its causes were not received: others may last."""
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), text_frame(7, "A07 OK 6 node_1 restarted", 5))
    assert ground.agent(7)["how"] == "ERROR"


@pytest.mark.parametrize(
    ("before", "line", "how"),
    [
        (None, "A07 FAIL 11111011 6 node_1 dead +2", "ERROR"),
        ({Slot.NODES: Level.ERROR}, "A07 OK 11111111", "OK"),
        ({Slot.NODES: Level.ERROR}, "A07 STALE 11111-11 6", "STALE"),
        (None, "A07 WARN 11111111 9 disk / 88%", "WARN"),
        (None, "A07 FAIL 11111111 0 x", "OK"),
    ],
)
def test_a_refresh_counts_until_the_next_heartbeat(
    ground: Ground, before: dict[Slot, Level] | None, line: str, how: str
) -> None:
    """Its digits are the newest about slots 1 to 8."""
    ground.receive(phm_heartbeat(7, before), text_frame(7, line, 6))
    assert ground.agent(7)["how"] == how


def test_a_ground_station_that_announces_its_end_is_no_longer_listed(ground: Ground) -> None:
    """So that the table of another `phm gcs` does not show it."""
    ground.receive(Heartbeat(250, 190, 6, 8, 0, 0, 4))
    assert ground.snapshot()["stations"] == [{"system": 250, "component": 190}]
    ground.receive(Heartbeat(250, 190, 6, 8, 0, 0, 7))
    assert ground.snapshot()["stations"] == []


# ---------------------------------------------------------------- presence


def test_a_silent_agent_is_lost_by_its_own_period(ground: Ground) -> None:
    """Late after 2.5 of its periods, lost after 5; then its slots are unknown, and its last report is kept separately."""
    ground.receive(phm_heartbeat(7, {Slot.FILES: Level.ERROR}))
    ground.wait(10, phm_heartbeat(7, {Slot.FILES: Level.ERROR}), every=1)
    ground.wait(3)
    assert ground.agent(7)["presence"] == "late"
    news = ground.wait(3)
    assert events(news, "presence") == [
        {"agent": 7, "name": "A07", "presence": "lost", "was": "alive", "silent_s": 5.2}
    ]
    agent = ground.agent(7)
    assert (agent["how"], agent["slots"], agent["last_slots"]["3"]) == ("LOST", {}, "ERROR")
    assert events(ground.receive(phm_heartbeat(7)), "presence")[0]["presence"] == "alive"
    assert ground.agent(7)["how"] == "OK"


def test_slow_heartbeats_of_a_large_swarm_are_not_a_loss(ground: Ground) -> None:
    """A period of 25 s is learned, the first heartbeats are given time, and one lost heartbeat is tolerated."""
    ground.receive(phm_heartbeat(7))
    ground.wait(100, phm_heartbeat(7), every=25)
    assert events(ground.wait(50, phm_heartbeat(7), every=50), "presence") == []
    assert ground.agent(7)["period_s"] == 25.0


def test_outages_are_not_the_usual_pause(ground: Ground) -> None:
    """At the edge of radio range an agent is lost again and again: the next loss is seen as soon as the first."""
    ground.receive(phm_heartbeat(7))
    ground.wait(18, phm_heartbeat(7), every=2)
    for _ in range(3):
        ground.wait(60)
        ground.receive(phm_heartbeat(7))
        ground.wait(2, phm_heartbeat(7), every=2)
    ground.wait(11)
    assert (ground.agent(7)["period_s"], ground.agent(7)["presence"]) == (2.0, "lost")


@pytest.mark.parametrize("second_link_s", [0.0, 0.5])
def test_a_longer_period_of_a_swarm_that_grows_is_learned(ground: Ground, second_link_s: float) -> None:
    """Pauses that follow each other are not outages, also if each heartbeat arrives a second time by another link."""

    def receive(count: int, period_s: float) -> None:
        for _ in range(count):
            ground.receive(phm_heartbeat(7))
            ground.wait(second_link_s)
            ground.receive(phm_heartbeat(7))
            ground.wait(period_s - second_link_s)

    receive(9, 2.0)
    receive(8, 40.0)
    assert ground.agent(7)["period_s"] == 40.0 - second_link_s
    assert ground.agent(7)["presence"] == "alive"


def test_an_answer_to_a_ground_station_does_not_change_the_period(ground: Ground) -> None:
    """Additional heartbeats, and copies of one, do not make the learned period shorter."""
    ground.receive(phm_heartbeat(7), phm_heartbeat(7))
    ground.wait(0.5)
    ground.receive(phm_heartbeat(7))
    ground.wait(40, phm_heartbeat(7), every=10)
    assert ground.agent(7)["period_s"] == 10.0


def test_an_agent_that_was_shut_down_has_left(ground: Ground) -> None:
    """POWEROFF is its last report: it is not lost, however long it is gone."""
    ground.receive(phm_heartbeat(7))
    news = ground.receive(phm_heartbeat(7, state=7))
    assert events(news, "presence")[0]["presence"] == "left"
    assert events(ground.wait(100), "presence") == []
    assert (ground.agent(7)["how"], ground.agent(7)["hop"]) == ("LEFT", None)


def test_a_restart_discards_earlier_reports(ground: Ground) -> None:
    """A heartbeat with BOOT after others: the new PHM reports everything again."""
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), text_frame(7, "A07 FAIL 6 node_1 dead"))
    news = ground.receive(Heartbeat(7, 193, 18, 8, 0, 1 << 30, 1))
    assert events(news, "restart")[0]["restarts"] == 1
    agent = ground.agent(7)
    assert (agent["bad"], agent["restarts"], agent["how"]) == ([], 1, "BOOT")


def test_wrong_clocks_change_nothing(ground: Ground) -> None:
    """Ages use the ground's monotonic clock: its UTC may jump by years, and clocks of agents are never used."""
    ground.receive(phm_heartbeat(7), text_frame(7, "A07 OK 11111111"))
    ground.wait(2)
    ground.clock.jump_utc(-3e8)
    agent = ground.agent(7)
    assert (agent["age_s"], agent["line"]["age_s"], agent["presence"]) == (2.0, 2.0, "alive")
    ground.clock.jump_utc(1e12)  # a year beyond the range of dates
    news = ground.receive(phm_heartbeat(7, {Slot.FILES: Level.WARN}))
    line = json.loads(encode(news[0], "run", 1))
    assert line["mono"] == ground.clock.mono()
    assert line["utc_s"] == ground.clock.utc()


# ---------------------------------------------------------------- autopilots


def test_arming_is_shown_with_the_agent(ground: Ground) -> None:
    """An event when it changes, and when the autopilot falls silent."""
    ground.receive(phm_heartbeat(7))
    assert events(ground.receive(autopilot(7)), "autopilot")[0]["armed"] is False
    assert ground.receive(autopilot(7)) == []
    assert events(ground.receive(autopilot(7, armed=True)), "autopilot")[0]["armed"] is True
    assert ground.agent(7)["autopilot"]["armed"] is True
    assert [body["presence"] for body in events(ground.wait(20, phm_heartbeat(7)), "autopilot")] == ["lost"]
    assert ground.agent(7)["autopilot"]["presence"] == "lost"


def test_other_ground_stations_are_listed_while_they_are_received(ground: Ground) -> None:
    """So one can see whether the pilot's own station is on the network."""
    ground.receive(Heartbeat(255, 190, 6, 8, 0, 0, 4))
    assert ground.snapshot()["stations"] == [{"system": 255, "component": 190}]
    ground.wait(20)
    assert ground.snapshot()["stations"] == []


# ---------------------------------------------------------------- hostile frames


def test_forged_agents_do_not_displace_real_ones() -> None:
    """There is room for 512; a departed agent is displaced, a present or expected one is not."""
    ground = Ground(expected=(100,))
    ground.receive(*(Heartbeat(number, 193, 18, 8, 0, 1 << 30, 4) for number in range(1, 100)))
    for component in range(200, 210):
        ground.receive(*(Heartbeat(number, component, 18, 8, 0, 1 << 30, 4) for number in range(1, 251)))
    snapshot = ground.snapshot()
    assert len(snapshot["agents"]) == 512
    assert snapshot["refused"] > 1900
    assert {one["agent"] for one in snapshot["agents"] if one["component"] == 193} == set(range(1, 101))
    ground.clock.advance(300)
    ground.receive(phm_heartbeat(150))
    assert ground.agent(150)["how"] == "OK"
    assert ground.agent(100)["presence"] == "never received"


def test_forged_agents_do_not_displace_a_lost_one() -> None:
    """Of those no longer received, those that were received for the shortest time make room: the operator must see the others as lost."""
    ground = Ground()
    ground.receive(phm_heartbeat(7))
    ground.wait(4.0, phm_heartbeat(7))
    for component in range(200, 206):
        ground.receive(*(phm_heartbeat(number, component=component) for number in range(1, 251)))
        ground.clock.advance(300)
    ground.receive(phm_heartbeat(8))
    assert (ground.agent(7)["how"], ground.agent(8)["how"]) == ("LOST", "OK")
    assert len(ground.snapshot()["agents"]) == 512


def test_memory_is_bounded(ground: Ground) -> None:
    """The number of stored lines, fault numbers and ground stations has a limit."""
    ground.receive(phm_heartbeat(7, dict.fromkeys(Slot, Level.ERROR)))
    for number in range(500):
        ground.receive(text_frame(7, f"A07 FAIL {number % 15 + 1} unit {number} bad"))
        ground.receive(tunnel_frame(7, tunnel.FaultDetail(f"ab-{number}", 0, 16, b"x")))
        ground.receive(Heartbeat(number % 256, number // 2 % 256, 6, 8, 0, 0, 4))
    held = ground.store.fleet.agents[7, 193]
    assert len(ground.agent(7)["bad"]) == 15 * MAX_BAD
    assert len(held.details) == 4
    assert len(ground.snapshot()["stations"]) == 16


@pytest.mark.parametrize(("to", "replies"), [((0, 0), 1), ((254, 190), 1), ((253, 190), 0), ((254, 191), 0)])
def test_a_reply_to_another_ground_station_is_ignored(ground: Ground, to: tuple[int, int], replies: int) -> None:
    """It would be the answer to a request of this one. The details of a fault are the same for all."""
    ground.receive(phm_heartbeat(7))
    for about, count in (("reply", replies), ("ab12-17", 1)):
        (payload,) = [tunnel.encode(part) for part in tunnel.details(about, "restarted")]
        data = list(payload.ljust(tunnel.MAX_BYTES, b"\0"))
        message = mavlink.MAVLink_tunnel_message(*to, tunnel.PAYLOAD_TYPE, len(payload), data)
        frame = parse(Sender(7, 193).received(message))
        assert frame is not None
        assert len(events(ground.receive(frame), "detail")) == count


def test_unknown_senders_and_types_of_tunnels_are_ignored(ground: Ground) -> None:
    """Only agents whose heartbeat was received count, and only payloads of the contract."""
    payload = tunnel.encode(PeerView(1, False, False, False, {3: PeerState.LOST}))
    ground.receive(phm_heartbeat(7))
    for frame in (
        TunnelPayload(8, 193, tunnel.PAYLOAD_TYPE, payload),
        TunnelPayload(7, 193, 5, payload),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b""),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b"\xff" * 128),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b"\x12\x01\x05"),
    ):
        assert ground.receive(frame) == []
    assert ground.agent(7)["view"] is None
