"""Lines of text from agents: the bad units that they name, and what is shown of them."""

from __future__ import annotations

import pytest

from phm.core.model import Level, Slot, Stamp
from phm.gcs.events import describe_with_time
from phm.gcs.fleet_state import FleetState
from phm.gcs.frames import Heartbeat, StatusText
from phm.reporters.statustext import FULL_LINES
from phm.wire import status_line, status_word
from tests.gcs.bench import Ground, events, phm_heartbeat, text_frame


@pytest.fixture
def ground() -> Ground:
    return Ground()


def test_lines_name_the_bad_units_until_they_recover(ground: Ground) -> None:
    """Two units of one slot, one of them recovered by name; the heartbeat with an OK slot ends the rest."""
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}))
    ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead"), text_frame(7, "A07 FAIL 6 node_2 dead"))
    ground.receive(text_frame(7, "A07 OK 6 node_2 restarted", 5))
    assert [bad["text"] for bad in ground.agent(7)["bad"]] == ["node_1 dead"]
    ground.receive(phm_heartbeat(7))
    assert ground.agent(7)["bad"] == []


def test_giving_up_adds_no_second_unit(ground: Ground) -> None:
    """Its line is about the failure that was reported, with a number and perhaps a target: both end together."""
    failed = {Slot.CONTAINER: Level.ERROR}
    ground.receive(phm_heartbeat(7, failed), text_frame(7, "A07 FAIL 2 exited 1"))
    ground.receive(text_frame(7, "A07 GAVE UP 2 ros_app: exited 1 #17"), text_frame(7, "A07 FAIL 2 nav exited 1"))
    assert [bad["text"] for bad in ground.agent(7)["bad"]] == ["exited 1", "nav exited 1"]
    ground.receive(text_frame(7, "A07 OK 2 cleared: exited 1", 5))
    assert [bad["text"] for bad in ground.agent(7)["bad"]] == ["nav exited 1"]
    ground.receive(text_frame(7, "A07 GAVE UP 2 nav exited 1 #18"), text_frame(7, "A07 OK 2 cleared: nav exited 1", 5))
    assert ground.agent(7)["bad"] == []


@pytest.mark.parametrize("end", ["refused", "failed"])
def test_the_result_of_a_request_is_not_a_failing_unit(ground: Ground, end: str) -> None:
    """It is shown, and the agent stays OK."""
    text = status_line.operator_request(7, Slot.CONTAINER, "restart", end, "ros_app")
    ground.receive(phm_heartbeat(7), text_frame(7, text, 4))
    agent = ground.agent(7)
    assert (agent["how"], agent["bad"], agent["line"]["text"]) == ("OK", [], f"A07 WARN 2 restart {end}: ros_app")


def test_a_refresh_corrects_missed_lines(ground: Ground) -> None:
    """Radios lose lines: the refresh knows exactly one bad unit, or none."""
    bad = {Slot.NODES: Level.ERROR, Slot.FILES: Level.ERROR}
    ground.receive(
        phm_heartbeat(7, bad), text_frame(7, "A07 FAIL 6 node_1 dead"), text_frame(7, "A07 FAIL 3 map.bin missing")
    )
    ground.receive(text_frame(7, "A07 FAIL 11111011 6 node_2 dead +1", 6))
    assert [entry["text"] for entry in ground.agent(7)["bad"]] == ["map.bin missing", "node_1 dead", "node_2 dead"]
    ground.receive(text_frame(7, "A07 FAIL 11111011 6 node_1 dead", 6))
    assert [entry["text"] for entry in ground.agent(7)["bad"]] == ["node_1 dead"]
    ground.receive(text_frame(7, "A07 OK 11111111", 6))
    assert ground.agent(7)["bad"] == []


def test_a_repeated_refresh_is_recorded_and_not_shown(ground: Ground) -> None:
    """The operator sees only a refresh that differs from the last."""
    ground.receive(phm_heartbeat(7))
    first = ground.receive(text_frame(7, "A07 OK 11111111", 6))
    again = ground.receive(text_frame(7, "A07 OK 11111111", 6))
    assert [bool(describe_with_time(news)) for news in first + again] == [True, False]
    assert events(again, "text")[0]["repeat"] is True


def test_an_agent_with_two_links_to_the_ground_is_reported_once(ground: Ground) -> None:
    """Each line and each heartbeat arrives twice: neither a second line nor a shorter period."""
    ground.receive(phm_heartbeat(7))
    first, second = (
        ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead")),
        ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead")),
    )
    assert (bool(describe_with_time(first[0])), bool(describe_with_time(second[0]))) == (True, False)
    for _ in range(10):
        ground.wait(0.5)
        ground.receive(phm_heartbeat(7))
        ground.wait(1.5)
        ground.receive(phm_heartbeat(7))
    assert ground.agent(7)["period_s"] == 1.5
    assert describe_with_time(ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead"))[0])


@pytest.mark.parametrize("line", ["A07 FAIL 6 node_1 dead", "A07 GAVE UP 6 node_1 dead #17"])
def test_a_failure_sent_again_for_a_new_ground_station_is_a_repetition(ground: Ground, line: str) -> None:
    """It was received, has not ended, and its slot was never OK since. After that, or if it is worse, it is new."""
    bad = phm_heartbeat(7, {Slot.NODES: Level.ERROR})

    def repeat(text: str) -> bool:
        return bool(events(ground.receive(text_frame(7, text)), "text")[0]["repeat"])

    assert [repeat("A07 WARN 6 node_1 dead"), repeat("A07 FAIL 6 node_1 dead")] == [False, False]
    assert repeat(line) is (line == "A07 FAIL 6 node_1 dead")
    ground.wait(20, bad)
    assert [repeat("A07 FAIL 6 node_1 dead"), repeat(line), repeat("A07 FAIL 6 node_2 dead")] == [True, True, False]
    ground.wait(6, bad)  # a second link may repeat a line for 5 s
    ground.receive(text_frame(7, "A07 OK 6 node_1 restarted", 5))
    assert repeat(line) is False
    ground.wait(20, bad)
    ground.receive(phm_heartbeat(7))
    assert repeat(line) is False


def test_all_failures_sent_again_for_a_new_ground_station_are_repetitions(ground: Ground) -> None:
    """Also if all of them are of one slot."""
    bad, lines = (
        phm_heartbeat(7, {Slot.NODES: Level.ERROR}),
        [f"A07 FAIL 6 node_{one} dead" for one in range(FULL_LINES)],
    )
    repeated: list[list[bool]] = []
    for _ in range(2):
        ground.wait(6, bad)  # a second link may repeat a line for 5 s
        found = [events(ground.receive(text_frame(7, line)), "text")[0] for line in lines]
        repeated.append([bool(one["repeat"]) for one in found])
    assert repeated == [[False] * FULL_LINES, [True] * FULL_LINES]


def test_a_failure_that_comes_back_is_new_although_its_text_had_changed(ground: Ground) -> None:
    """Its end names only the newest text, and the heartbeat that shows the end may be 40 s late."""
    ground.receive(phm_heartbeat(7, {Slot.COMPANION: Level.ERROR}))
    for seconds in (3, 5):
        ground.receive(text_frame(7, f"A07 FAIL 1 GCS: no heartbeat {seconds} s"))
    ground.wait(6)
    ground.receive(text_frame(7, "A07 OK 1 recovered: GCS: no heartbeat 5 s", 5))
    (line,) = events(ground.receive(text_frame(7, "A07 FAIL 1 GCS: no heartbeat 3 s")), "text")
    assert line["repeat"] is False


def test_a_failure_known_only_from_a_refresh_is_new_when_its_line_arrives(ground: Ground) -> None:
    """A refresh raises no alarm, and the line about the change may have been lost. A failure that got worse again is new, too."""
    ground.receive(phm_heartbeat(7, {Slot.NODES: Level.ERROR}), text_frame(7, "A07 FAIL 11111011 6 node_1 dead", 6))
    found: list[bool] = []
    for word in ("FAIL", "WARN", "FAIL"):
        ground.wait(6, phm_heartbeat(7, {Slot.NODES: Level.ERROR}))
        found += [one["repeat"] for one in events(ground.receive(text_frame(7, f"A07 {word} 6 node_1 dead")), "text")]
    assert found == [False, False, False]


def test_a_slot_missing_from_a_refresh_is_stale(ground: Ground) -> None:
    """Unused and unknown are equal in the status word: the refresh distinguishes them."""
    ground.receive(phm_heartbeat(7), text_frame(7, "A07 STALE 11111--- 6", 6))
    assert ground.agent(7)["how"] == "STALE"
    ground.receive(text_frame(7, "A07 OK 11111111", 6))
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
    ground.receive(phm_heartbeat(7), phm_heartbeat(8))
    news = ground.receive(frame)
    assert (events(news, "text")[0]["phm"], events(news, "text")[0].get("agent")) == (False, None)
    assert ground.agent(7)["bad"] == ground.agent(8)["bad"] == []
    assert ground.agent(7)["line"] is None
    assert ground.snapshot()["swarm"] is None


def test_a_line_before_the_first_heartbeat_is_not_lost(ground: Ground) -> None:
    """From PHM's usual component, about itself: the agent is known by it, and everything else of it is unknown."""
    ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead"))
    agent = ground.agent(7)
    assert (agent["line"]["text"], agent["how"], agent["presence"]) == (
        "A07 FAIL 6 node_1 dead",
        "UNKNOWN",
        "never received",
    )


def test_with_a_key_unsigned_frames_are_not_accepted() -> None:
    """A forged agent has no row, and a forged line of a real one is shown with its sender and changes nothing."""
    store = FleetState(signed=True)
    word = status_word.encode({Slot.NODES: Level.OK})
    store.receive(Heartbeat(7, 193, 18, 8, 0, word, 4, signed=True), "link", Stamp(0.0, 0.0))
    store.receive(Heartbeat(8, 193, 18, 8, 0, word, 4), "link", Stamp(0.0, 0.0))
    store.receive(Heartbeat(7, 193, 18, 8, 0, word, 7), "link", Stamp(0.1, 0.1))
    (news,) = store.receive(StatusText(7, 193, 2, "A07 FAIL 6 node_1 dead"), "link", Stamp(0.2, 0.2))
    (agent,) = store.snapshot(Stamp(0.3, 0.3))["agents"]
    assert (agent["name"], agent["presence"], agent["bad"]) == ("A07", "alive", [])
    assert news.body["phm"] is False
    (news,) = store.receive(StatusText(7, 193, 2, "A07 FAIL 6 node_1 dead", signed=True), "link", Stamp(0.4, 0.4))
    assert news.body["phm"] is True


def test_text_cannot_control_a_terminal(ground: Ground) -> None:
    """Escape sequences and line breaks are shown literally."""
    from phm.gcs.frames import parse
    from tests.fakes.mavlink import Sender, text

    message = Sender(7, 1).received(text("\x1b[2Jgone\nA07 OK"))
    frame = parse(message)
    assert isinstance(frame, StatusText)
    assert frame.text == "\\x1b[2Jgone\\nA07 OK"
