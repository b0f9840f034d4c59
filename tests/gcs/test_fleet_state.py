"""What the ground station derives from frames: agents, their state, broken hops, and what is unknown."""

from __future__ import annotations

import json

import pytest

from phm.core.model import Level, Slot, Stamp
from phm.gcs.events import describe_with_time, encode
from phm.gcs.fleet_state import FleetState
from phm.gcs.frames import Heartbeat, RadioStatus, StatusText, TunnelPayload
from phm.wire import status_word, tunnel
from phm.wire.tunnel import PeerState, PeerView, StatusWords, SwarmDigest
from tests.gcs.bench import EMERGENCY, HEALTHY, Ground, events, phm_heartbeat, pilot, text_frame, tunnel_frame


@pytest.fixture
def ground() -> Ground:
    return Ground()


# ---------------------------------------------------------------- known agents


def test_an_unlisted_agent_is_discovered_by_its_heartbeat(ground: Ground) -> None:
    """One event for the agent and one for its slots; an equal heartbeat causes none."""
    news = ground.hear(phm_heartbeat(9, {Slot.NODES: Level.ERROR}, state=EMERGENCY))
    assert [one.event for one in news] == ["agent", "slots"]
    assert events(news, "agent")[0]["name"] == "A09"
    agent = ground.agent(9)
    assert (agent["how"], agent["presence"], agent["state"]) == ("ERROR", "alive", "EMERGENCY")
    assert agent["slots"] == {**{str(int(slot)): "OK" for slot in HEALTHY}, "6": "ERROR"}
    assert ground.hear(phm_heartbeat(9, {Slot.NODES: Level.ERROR}, state=EMERGENCY)) == []


def test_unreported_state_is_unknown() -> None:
    """An expected agent that was never received, one that has not reported its slots, and slots that it omits."""
    ground = Ground(expected=(3,))
    agent = ground.agent(3)
    assert (agent["how"], agent["presence"], agent["slots"], agent["age_s"]) == ("UNKNOWN", "never heard", {}, None)
    assert (agent["line"], agent["pilot"], agent["hears_ground"], agent["period_s"]) == (None, None, None, None)
    ground.hear(Heartbeat(3, 193, 18, 8, 0, 1 << 30, 4))
    assert (ground.agent(3)["how"], ground.agent(3)["slots"]) == ("UNKNOWN", {})
    ground.hear(phm_heartbeat(3, {Slot.FILES: Level.STALE}))
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
    ground.hear(frame)
    assert ground.snapshot()["agents"] == []


def test_a_status_word_of_another_version_is_reported_as_unreadable(ground: Ground) -> None:
    """Once; the agent is listed, and its slots are unknown."""
    news = ground.hear(Heartbeat(9, 193, 18, 8, 0, 2 << 30 | 1, 4))
    assert "version 2" in events(news, "problem")[0]["text"]
    assert ground.hear(Heartbeat(9, 193, 18, 8, 0, 2 << 30 | 1, 4)) == []
    assert (ground.agent(9)["how"], ground.agent(9)["slots"]) == ("UNKNOWN", {})


def test_two_phms_of_one_vehicle_are_two_rows(ground: Ground) -> None:
    """A second PHM on another component does not hide the first."""
    ground.hear(phm_heartbeat(7), phm_heartbeat(7, {Slot.FILES: Level.ERROR}, component=195))
    assert [(one["name"], one["how"]) for one in ground.snapshot()["agents"]] == [("A07", "OK"), ("A07/195", "ERROR")]


# ---------------------------------------------------------------- what was reported last


def test_a_line_counts_until_the_next_heartbeat(ground: Ground) -> None:
    """A failure or its end is known by whichever is received first."""
    ground.hear(phm_heartbeat(7), text_frame(7, "A07 FAIL 6 node_1 dead"))
    assert (ground.agent(7)["how"], ground.agent(7)["slots"]["6"]) == ("ERROR", "ERROR")
    ground.hear(text_frame(7, "A07 FAIL 6 node_2 dead"), text_frame(7, "A07 OK 6 node_1 restarted", 5))
    assert ground.agent(7)["how"] == "ERROR"
    ground.hear(text_frame(7, "A07 OK 6 node_2 restarted", 5))
    assert (ground.agent(7)["how"], ground.agent(7)["slots"]["6"]) == ("OK", "OK")
    ground.hear(phm_heartbeat(7, {Slot.NODES: Level.ERROR}))
    assert ground.agent(7)["how"] == "ERROR"


def test_the_end_of_an_unknown_failure_proves_nothing(ground: Ground) -> None:
    """The heartbeat says ERROR, and the lines about its causes were not received: others may last."""
    ground.hear(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), text_frame(7, "A07 OK 6 node_1 restarted", 5))
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
    ground.hear(phm_heartbeat(7, before), text_frame(7, line, 6))
    assert ground.agent(7)["how"] == how


def test_a_ground_station_that_announces_its_end_is_no_longer_listed(ground: Ground) -> None:
    """So that the table of another `phm gcs` does not show it."""
    ground.hear(Heartbeat(250, 190, 6, 8, 0, 0, 4))
    assert ground.snapshot()["stations"] == [{"system": 250, "component": 190}]
    ground.hear(Heartbeat(250, 190, 6, 8, 0, 0, 7))
    assert ground.snapshot()["stations"] == []


# ---------------------------------------------------------------- presence


def test_a_silent_agent_is_lost_by_its_own_period(ground: Ground) -> None:
    """Late after 2.5 of its periods, lost after 5; then its slots are unknown, and its last report is kept separately."""
    ground.hear(phm_heartbeat(7, {Slot.FILES: Level.ERROR}))
    ground.wait(10, phm_heartbeat(7, {Slot.FILES: Level.ERROR}), every=1)
    ground.wait(3)
    assert ground.agent(7)["presence"] == "late"
    news = ground.wait(3)
    assert events(news, "presence") == [
        {"agent": 7, "name": "A07", "presence": "lost", "was": "alive", "silent_s": 5.2}
    ]
    agent = ground.agent(7)
    assert (agent["how"], agent["slots"], agent["last_slots"]["3"]) == ("LOST", {}, "ERROR")
    assert events(ground.hear(phm_heartbeat(7)), "presence")[0]["presence"] == "alive"
    assert ground.agent(7)["how"] == "OK"


def test_slow_heartbeats_of_a_large_swarm_are_not_a_loss(ground: Ground) -> None:
    """A period of 25 s is learned, the first heartbeats are given time, and one lost heartbeat is tolerated."""
    ground.hear(phm_heartbeat(7))
    ground.wait(100, phm_heartbeat(7), every=25)
    assert events(ground.wait(50, phm_heartbeat(7), every=50), "presence") == []
    assert ground.agent(7)["period_s"] == 25.0


def test_an_answer_to_a_ground_station_does_not_change_the_period(ground: Ground) -> None:
    """Additional heartbeats, and copies of one, do not make the learned period shorter."""
    ground.hear(phm_heartbeat(7), phm_heartbeat(7))
    ground.wait(0.5)
    ground.hear(phm_heartbeat(7))
    ground.wait(40, phm_heartbeat(7), every=10)
    assert ground.agent(7)["period_s"] == 10.0


def test_an_agent_that_was_shut_down_has_left(ground: Ground) -> None:
    """POWEROFF is its last report: it is not lost, however long it is gone."""
    ground.hear(phm_heartbeat(7))
    news = ground.hear(phm_heartbeat(7, state=7))
    assert events(news, "presence")[0]["presence"] == "left"
    assert events(ground.wait(100), "presence") == []
    assert (ground.agent(7)["how"], ground.agent(7)["hop"]) == ("LEFT", None)


def test_a_restart_discards_earlier_reports(ground: Ground) -> None:
    """A heartbeat with BOOT after others: the new PHM reports everything again."""
    ground.hear(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), text_frame(7, "A07 FAIL 6 node_1 dead"))
    news = ground.hear(Heartbeat(7, 193, 18, 8, 0, 1 << 30, 1))
    assert events(news, "restart")[0]["restarts"] == 1
    agent = ground.agent(7)
    assert (agent["bad"], agent["restarts"], agent["how"]) == ([], 1, "BOOT")


def test_wrong_clocks_change_nothing(ground: Ground) -> None:
    """Ages use the ground's monotonic clock: its UTC may jump by years, and clocks of agents are never used."""
    ground.hear(phm_heartbeat(7), text_frame(7, "A07 OK 11111111"))
    ground.wait(2)
    ground.clock.jump_utc(-3e8)
    agent = ground.agent(7)
    assert (agent["age_s"], agent["line"]["age_s"], agent["presence"]) == (2.0, 2.0, "alive")
    ground.clock.jump_utc(1e12)  # a year beyond the range of dates
    news = ground.hear(phm_heartbeat(7, {Slot.FILES: Level.WARN}))
    line = json.loads(encode(news[0], "run", 1))
    assert line["mono"] == ground.clock.mono()
    assert line["utc_s"] == ground.clock.utc()


# ---------------------------------------------------------------- lines


def test_lines_name_the_bad_units_until_they_recover(ground: Ground) -> None:
    """Two units of one slot, one of them recovered by name; the heartbeat with an OK slot ends the rest."""
    ground.hear(phm_heartbeat(7, {Slot.NODES: Level.ERROR}))
    ground.hear(text_frame(7, "A07 FAIL 6 node_1 dead"), text_frame(7, "A07 FAIL 6 node_2 dead"))
    ground.hear(text_frame(7, "A07 OK 6 node_2 restarted", 5))
    assert [bad["text"] for bad in ground.agent(7)["bad"]] == ["node_1 dead"]
    ground.hear(phm_heartbeat(7))
    assert ground.agent(7)["bad"] == []


def test_a_refresh_corrects_missed_lines(ground: Ground) -> None:
    """Radios lose lines: the refresh knows exactly one bad unit, or none."""
    bad = {Slot.NODES: Level.ERROR, Slot.FILES: Level.ERROR}
    ground.hear(
        phm_heartbeat(7, bad), text_frame(7, "A07 FAIL 6 node_1 dead"), text_frame(7, "A07 FAIL 3 map.bin missing")
    )
    ground.hear(text_frame(7, "A07 FAIL 11111011 6 node_2 dead +1", 6))
    assert [entry["text"] for entry in ground.agent(7)["bad"]] == ["map.bin missing", "node_1 dead", "node_2 dead"]
    ground.hear(text_frame(7, "A07 FAIL 11111011 6 node_1 dead", 6))
    assert [entry["text"] for entry in ground.agent(7)["bad"]] == ["node_1 dead"]
    ground.hear(text_frame(7, "A07 OK 11111111", 6))
    assert ground.agent(7)["bad"] == []


def test_a_repeated_refresh_is_recorded_and_not_shown(ground: Ground) -> None:
    """The operator sees only a refresh that differs from the last."""
    ground.hear(phm_heartbeat(7))
    first = ground.hear(text_frame(7, "A07 OK 11111111", 6))
    again = ground.hear(text_frame(7, "A07 OK 11111111", 6))
    assert [bool(describe_with_time(news)) for news in first + again] == [True, False]
    assert events(again, "text")[0]["repeat"] is True


def test_an_agent_with_two_links_to_the_ground_is_reported_once(ground: Ground) -> None:
    """Each line and each heartbeat arrives twice: neither a second line nor a shorter period."""
    ground.hear(phm_heartbeat(7))
    first, second = (
        ground.hear(text_frame(7, "A07 FAIL 6 node_1 dead")),
        ground.hear(text_frame(7, "A07 FAIL 6 node_1 dead")),
    )
    assert (bool(describe_with_time(first[0])), bool(describe_with_time(second[0]))) == (True, False)
    for _ in range(10):
        ground.wait(0.5)
        ground.hear(phm_heartbeat(7))
        ground.wait(1.5)
        ground.hear(phm_heartbeat(7))
    assert ground.agent(7)["period_s"] == 1.5
    assert describe_with_time(ground.hear(text_frame(7, "A07 FAIL 6 node_1 dead"))[0])


def test_a_slot_missing_from_a_refresh_is_stale(ground: Ground) -> None:
    """Unused and unknown are equal in the status word: the refresh distinguishes them."""
    ground.hear(phm_heartbeat(7), text_frame(7, "A07 STALE 11111--- 6", 6))
    assert ground.agent(7)["how"] == "STALE"
    ground.hear(text_frame(7, "A07 OK 11111111", 6))
    assert ground.agent(7)["how"] == "OK"


@pytest.mark.parametrize(
    "frame",
    [
        text_frame(7, "A07 FAIL 6 node_1 dead", component=1),
        text_frame(7, "A08 FAIL 6 node_1 dead"),
        text_frame(8, "A07 FAIL 6 node_1 dead"),
        text_frame(7, "PreArm: GPS 1 failing", component=193),
        text_frame(255, "SWARM 8/8 OK", component=190),
    ],
    ids=["the autopilot", "about another", "by another", "other words", "a ground station"],
)
def test_lines_of_other_programs_are_shown_with_their_sender(ground: Ground, frame: StatusText) -> None:
    """They are recorded with their sender, and change no agent."""
    ground.hear(phm_heartbeat(7), phm_heartbeat(8))
    news = ground.hear(frame)
    assert (events(news, "text")[0]["phm"], events(news, "text")[0].get("agent")) == (False, None)
    assert ground.agent(7)["bad"] == ground.agent(8)["bad"] == []
    assert ground.agent(7)["line"] is None
    assert ground.snapshot()["swarm"] is None


def test_a_line_before_the_first_heartbeat_is_not_lost(ground: Ground) -> None:
    """From PHM's usual component, about itself: the agent is known by it, and everything else of it is unknown."""
    ground.hear(text_frame(7, "A07 FAIL 6 node_1 dead"))
    agent = ground.agent(7)
    assert (agent["line"]["text"], agent["how"], agent["presence"]) == (
        "A07 FAIL 6 node_1 dead",
        "UNKNOWN",
        "never heard",
    )


def test_with_a_key_unsigned_frames_are_not_accepted() -> None:
    """A forged agent has no row, and a forged line of a real one is shown with its sender and changes nothing."""
    store = FleetState(signed=True)
    word = status_word.encode({Slot.NODES: Level.OK})
    store.hear(Heartbeat(7, 193, 18, 8, 0, word, 4, signed=True), "link", Stamp(0.0, 0.0))
    store.hear(Heartbeat(8, 193, 18, 8, 0, word, 4), "link", Stamp(0.0, 0.0))
    store.hear(Heartbeat(7, 193, 18, 8, 0, word, 7), "link", Stamp(0.1, 0.1))
    (news,) = store.hear(StatusText(7, 193, 2, "A07 FAIL 6 node_1 dead"), "link", Stamp(0.2, 0.2))
    (agent,) = store.snapshot(Stamp(0.3, 0.3))["agents"]
    assert (agent["name"], agent["presence"], agent["bad"]) == ("A07", "alive", [])
    assert news.body["phm"] is False
    (news,) = store.hear(StatusText(7, 193, 2, "A07 FAIL 6 node_1 dead", signed=True), "link", Stamp(0.4, 0.4))
    assert news.body["phm"] is True


def test_text_cannot_control_a_terminal(ground: Ground) -> None:
    """Escape sequences and line breaks are shown literally."""
    from phm.gcs.frames import parse
    from tests.fakes.mavlink import Sender, text

    message = Sender(7, 1).received(text("\x1b[2Jgone\nA07 OK"))
    frame = parse(message)
    assert isinstance(frame, StatusText)
    assert frame.text == "\\x1b[2Jgone\\nA07 OK"


# ---------------------------------------------------------------- the swarm


def test_views_list_which_agents_receive_an_agent(ground: Ground) -> None:
    """An agent that is lost here and received there has a broken radio; a view of a lost agent no longer counts."""
    ground.hear(*(phm_heartbeat(number) for number in (1, 2, 3)))
    both = PeerView(1, gcs=True, autopilot=True, radio=False, peers={3: PeerState.ALIVE})
    ground.hear(
        tunnel_frame(1, both),
        tunnel_frame(2, PeerView(1, gcs=True, autopilot=True, radio=False, peers={3: PeerState.LOST})),
    )
    ground.wait(20, phm_heartbeat(1), phm_heartbeat(2))
    agent = ground.agent(3)
    assert (agent["heard_by"], agent["not_heard_by"]) == ([1], [2])
    assert agent["hop"] == {"name": "radio", "evidence": "silent 20 s here, heard by A01", "certain": True}
    ground.wait(20, phm_heartbeat(2))
    assert ground.agent(3)["heard_by"] == []


def test_an_equal_view_causes_no_event(ground: Ground) -> None:
    """Its number increases; its content is the same."""
    ground.hear(phm_heartbeat(1))
    assert len(ground.hear(tunnel_frame(1, PeerView(1, True, True, False, {2: PeerState.ALIVE})))) == 1
    assert ground.hear(tunnel_frame(1, PeerView(2, True, True, False, {2: PeerState.ALIVE}))) == []
    assert len(ground.hear(tunnel_frame(1, PeerView(3, True, True, False, {2: PeerState.LOST})))) == 1


def test_the_leader_reports_agents_never_received_here(ground: Ground) -> None:
    """They have a row with the leader's report, and nothing else."""
    ground.hear(phm_heartbeat(1), text_frame(1, "SWARM 1/3 FAIL A05:lost", 6))
    ground.hear(tunnel_frame(1, SwarmDigest(3, 2, {1: Level.OK, 4: Level.WARN, 5: Level.ERROR})))
    assert (ground.agent(4)["how"], ground.agent(4)["swarm_says"]) == ("UNKNOWN", "WARN")
    assert ground.agent(5)["swarm_says"] == "ERROR"
    swarm = ground.snapshot()["swarm"]
    assert (swarm["by"], swarm["line"], swarm["members"], swarm["alive"]) == (1, "SWARM 1/3 FAIL A05:lost", 3, 2)


def test_an_agent_without_a_radio_is_reported_by_a_relay(ground: Ground) -> None:
    """Its last line is the relay's report, with the relay's name."""
    ground.hear(phm_heartbeat(1), text_frame(1, "A03 no GCS radio, heard by A01 A02: 2 ERROR"))
    agent = ground.agent(3)
    assert (agent["line"]["via"], agent["hears_ground"], agent["how"]) == (1, False, "UNKNOWN")


def test_a_relay_is_over_when_the_swarm_is_ok(ground: Ground) -> None:
    """By a swarm line without the agent, or by the agent's own line; a truncated swarm line proves nothing."""
    for line in (text_frame(1, "SWARM 3/3 OK", 6), text_frame(3, "A03 OK 1 recovered: GCS: no heartbeat 10 s", 5)):
        ground.hear(phm_heartbeat(1), phm_heartbeat(3), text_frame(1, "A03 no GCS radio, heard by A01 A02: 2 ERROR"))
        ground.hear(text_frame(1, "SWARM 1/9 FAIL A04:lost +3", 6), text_frame(1, "SWARM 2/3 WARN A03:no-GCS", 6))
        assert ground.agent(3)["hop"]["name"] == "radio"
        ground.hear(line)
        assert ground.agent(3)["hop"] is None


def test_details_are_joined_from_their_parts(ground: Ground) -> None:
    """In any order, with characters that were split between two parts."""
    ground.hear(phm_heartbeat(7))
    parts = tunnel.details("ab12-17", "Übermaß " * 40)
    assert len(parts) > 2
    news = [one for part in reversed(parts) for one in ground.hear(tunnel_frame(7, part))]
    assert [body["text"] for body in events(news, "detail")] == ["Übermaß " * 40]


def test_status_words_of_other_agents_are_forwarded(ground: Ground) -> None:
    """As events; directly received data has priority over reports of others."""
    ground.hear(phm_heartbeat(7))
    assert events(ground.hear(tunnel_frame(7, StatusWords({7: 0, 8: 0x40025D55}))), "words")[0]["words"] == {
        "8": 0x40025D55
    }
    assert ground.agent(7)["how"] == "OK"


# ---------------------------------------------------------------- the first broken hop


@pytest.mark.parametrize(
    ("slots", "text", "hop"),
    [
        ({}, "", None),
        ({Slot.RADIO: Level.ERROR}, "A07 FAIL 11 radio: no RADIO_STATUS 6 s", ("radio", "no RADIO_STATUS 6 s", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 port fc: no permission", ("port fc", "no permission", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 GCS: no heartbeat 10 s", ("GCS", "no heartbeat 10 s", True)),
        ({Slot.COMPANION: Level.ERROR}, "A07 FAIL 1 rates overdue", ("companion", "rates overdue", False)),
        ({Slot.NODES: Level.ERROR}, "A07 FAIL 6 node_1 dead", ("application", "node_1 dead", False)),
        (
            {Slot.AUTOPILOT: Level.ERROR},
            "A07 FAIL 10 autopilot: no heartbeat 4 s",
            ("autopilot", "no heartbeat 4 s", True),
        ),
        ({Slot.AUTOPILOT: Level.ERROR}, "", ("autopilot", "ERROR in slot 10, cause not received", True)),
        ({Slot.RADIO: Level.WARN}, "A07 WARN 11 radio: weak, margin 8", None),
        ({Slot.FILES: Level.ERROR}, "A07 FAIL 3 map.bin missing", None),
    ],
)
def test_the_hop_is_the_first_that_the_agent_names(
    ground: Ground, slots: dict[Slot, Level], text: str, hop: tuple[str, str, bool] | None
) -> None:
    """From its lines, or from its status word while no line has a reason; a possible hop is marked as uncertain."""
    ground.hear(phm_heartbeat(7, slots))
    if text:
        ground.hear(text_frame(7, text))
    found = ground.agent(7)["hop"]
    assert (found and (found["name"], found["evidence"], found["certain"])) == hop


def test_the_hop_closest_to_the_ground_wins(ground: Ground) -> None:
    """Units behind a broken hop may be bad because of it."""
    ground.hear(phm_heartbeat(7, {Slot.RADIO: Level.ERROR, Slot.AUTOPILOT: Level.ERROR, Slot.NODES: Level.ERROR}))
    assert ground.agent(7)["hop"]["name"] == "radio"


def test_a_silent_agent_is_explained_by_other_received_frames(ground: Ground) -> None:
    """Of its autopilot, of other agents, or none: the companion, the radio, or the ground's own link."""
    ground.hear(phm_heartbeat(7), phm_heartbeat(8), pilot(7))
    ground.wait(20, pilot(7), phm_heartbeat(8), every=1)
    assert ground.agent(7)["hop"]["name"] == "companion"
    ground.wait(20, phm_heartbeat(8), every=1)
    assert ground.agent(7)["hop"] == {"name": "radio or vehicle", "evidence": "silent 40 s", "certain": False}
    ground.wait(20)
    assert ground.agent(7)["hop"] == {"name": "ground link", "evidence": "all agents are silent", "certain": False}
    ground.hear(RadioStatus(51, 68, 190, 180, 60, None, 99))
    assert ground.agent(7)["hop"]["name"] == "radio"
    assert ground.snapshot()["radios"] == [
        {"link": "gcs", "age_s": 0.0, "rssi": 190, "remrssi": 180, "noise": 60, "remnoise": None, "txbuf": 99}
    ]
    ground.store.links({"gcs": (False, "Connection refused")}, ground.clock.stamp())
    assert ground.agent(7)["hop"] == {"name": "ground link", "evidence": "gcs: Connection refused", "certain": True}


def test_an_agent_that_was_never_received_gets_time() -> None:
    """For five heartbeats an expected agent has no hop; then the hop says where to look."""
    ground = Ground(expected=(3,))
    assert ground.wait(9) == []
    assert [body["hop"]["evidence"] for body in events(ground.wait(2), "hop")] == ["never received"]


def test_a_hop_causes_one_event(ground: Ground) -> None:
    """When it breaks and when it works again; the growing duration of its silence causes none."""
    ground.hear(phm_heartbeat(7), phm_heartbeat(8))
    news = ground.wait(60, phm_heartbeat(8))
    assert [body["hop"]["name"] for body in events(news, "hop")] == ["radio or vehicle"]
    ground.hear(phm_heartbeat(7))
    assert [body["hop"] for body in events(ground.wait(1), "hop")] == [None]


def test_an_agent_without_contact_to_the_ground_reports_it_in_its_view(ground: Ground) -> None:
    """Its radio works in one direction only: it is received, but commands do not reach it."""
    ground.hear(phm_heartbeat(7), tunnel_frame(7, PeerView(1, gcs=False, autopilot=True, radio=False)))
    assert ground.agent(7)["hop"] == {
        "name": "radio",
        "evidence": "it does not receive the ground station",
        "certain": False,
    }


# ---------------------------------------------------------------- autopilots


def test_arming_is_shown_with_the_agent(ground: Ground) -> None:
    """An event when it changes, and when the autopilot falls silent."""
    ground.hear(phm_heartbeat(7))
    assert events(ground.hear(pilot(7)), "pilot")[0]["armed"] is False
    assert ground.hear(pilot(7)) == []
    assert events(ground.hear(pilot(7, armed=True)), "pilot")[0]["armed"] is True
    assert ground.agent(7)["pilot"]["armed"] is True
    assert [body["presence"] for body in events(ground.wait(20, phm_heartbeat(7)), "pilot")] == ["lost"]
    assert ground.agent(7)["pilot"]["presence"] == "lost"


def test_other_ground_stations_are_listed_while_they_are_received(ground: Ground) -> None:
    """So one can see whether the pilot's own station is on the network."""
    ground.hear(Heartbeat(255, 190, 6, 8, 0, 0, 4))
    assert ground.snapshot()["stations"] == [{"system": 255, "component": 190}]
    ground.wait(20)
    assert ground.snapshot()["stations"] == []


# ---------------------------------------------------------------- hostile frames


def test_forged_agents_do_not_displace_real_ones() -> None:
    """There is room for 512; a departed agent is displaced, a present or expected one is not."""
    ground = Ground(expected=(100,))
    ground.hear(*(Heartbeat(number, 193, 18, 8, 0, 1 << 30, 4) for number in range(1, 100)))
    for component in range(200, 210):
        ground.hear(*(Heartbeat(number, component, 18, 8, 0, 1 << 30, 4) for number in range(1, 251)))
    snapshot = ground.snapshot()
    assert len(snapshot["agents"]) == 512
    assert snapshot["refused"] > 1900
    assert {one["agent"] for one in snapshot["agents"] if one["component"] == 193} == set(range(1, 101))
    ground.clock.advance(300)
    ground.hear(phm_heartbeat(150))
    assert ground.agent(150)["how"] == "OK"
    assert ground.agent(100)["presence"] == "never heard"


def test_memory_is_bounded(ground: Ground) -> None:
    """The number of stored lines, fault numbers and ground stations has a limit."""
    ground.hear(phm_heartbeat(7, dict.fromkeys(Slot, Level.ERROR)))
    for number in range(500):
        ground.hear(text_frame(7, f"A07 FAIL {number % 15 + 1} unit {number} bad"))
        ground.hear(tunnel_frame(7, tunnel.FaultDetail(f"ab-{number}", 0, 16, b"x")))
        ground.hear(Heartbeat(number % 256, number // 2 % 256, 6, 8, 0, 0, 4))
    held = ground.store.fleet.agents[7, 193]
    assert len(ground.agent(7)["bad"]) == 60
    assert len(held.details) == 4
    assert len(ground.snapshot()["stations"]) == 16


def test_unknown_senders_and_types_of_tunnels_are_ignored(ground: Ground) -> None:
    """Only agents whose heartbeat was received count, and only payloads of the contract."""
    payload = tunnel.encode(PeerView(1, False, False, False, {3: PeerState.LOST}))
    ground.hear(phm_heartbeat(7))
    for frame in (
        TunnelPayload(8, 193, tunnel.PAYLOAD_TYPE, payload),
        TunnelPayload(7, 193, 5, payload),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b""),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b"\xff" * 128),
        TunnelPayload(7, 193, tunnel.PAYLOAD_TYPE, b"\x12\x01\x05"),
    ):
        assert ground.hear(frame) == []
    assert ground.agent(7)["view"] is None
