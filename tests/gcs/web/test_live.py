"""The page gets the complete state and then what changes, from real frames."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.core.model import Level, Slot
from tests.fakes.until import until
from tests.gcs.web.swarm import Ground, ground


@pytest.fixture(scope="module")
def here() -> Iterator[Ground]:
    with ground() as made:
        yield made


def test_a_frame_becomes_a_change_of_one_row(here: Ground) -> None:
    """A client gets the complete state once, then only the keys that differ."""
    one, two = here.vehicle(11), here.vehicle(12)
    live = here.live()
    one.heartbeat()
    two.heartbeat()
    until(lambda: live.agent("A11") and live.agent("A12"), "both rows")
    one.heartbeat({Slot.CONTAINER: Level.ERROR})
    until(lambda: live.agent("A11")["how"] == "ERROR", "the failure")
    assert len(live.of("full")) == 1
    changes = [body["agents"]["A11"] for body in live.of("delta") if "A11" in body.get("agents", {})]
    failed = next(change for change in changes if change.get("how") == "ERROR")
    assert {"how", "slots", "rank", "word"} <= failed.keys()
    assert "agent" not in failed
    assert live.agent("A11")["rank"] < live.agent("A12")["rank"]
    assert {"name": "container", "state": "perhaps"}.items() <= live.agent("A11")["hops"][3].items()


def test_names_from_the_air_stay_text(here: Ground) -> None:
    """Markup, quotes and line ends in a received line are characters of a JSON string, never part of the protocol."""
    vehicle, live = here.vehicle(13), here.live()
    vehicle.heartbeat()
    hostile = 'A13 FAIL 2 </script><img src=x>"\\\n\ndata: x'
    vehicle.say(hostile)
    until(lambda: [event for event in live.events() if event["who"] == "A13" and event["event"] == "text"], "the line")
    said = next(event for event in live.events() if event["who"] == "A13" and event["event"] == "text")
    assert "</script><img src=x>" in said["text"]
    assert "\n" not in said["text"]
    assert said["grade"] == "critical"
    assert {kind for kind, _ in live.messages} <= {"full", "delta", "events", "ping"}


def test_a_critical_line_is_an_alarm_until_it_is_acknowledged(here: Ground) -> None:
    """Silenced for a time it stays counted, but says until when it is silent."""
    vehicle, live, client = here.vehicle(14), here.live(), here.client()
    client.session()
    vehicle.heartbeat()
    vehicle.say("A14 FAIL 2 app exited 1")
    until(lambda: (live.agent("A14").get("alarm") or {}).get("count") == 1, "the alarm")
    client.post("/api/alarms", {"do": "silence", "agent": "A14", "for_s": 600})
    until(lambda: live.agent("A14")["alarm"]["silent_until"], "the silence")
    client.post("/api/alarms", {"do": "acknowledge", "agent": "A14"})
    until(lambda: live.agent("A14")["alarm"]["count"] == 0, "the acknowledgement")
    client.post("/api/alarms", {"do": "unsilence", "agent": "A14"})
    until(lambda: live.agent("A14")["alarm"] is None, "nothing left")


def test_a_silence_of_all_is_in_the_state_of_the_ground(here: Ground) -> None:
    """Without any alarm, so that the page can end it."""
    live, client = here.live(), here.client()
    client.session()
    until(lambda: "alarms_silent_until" in live.state.get("ground", {}), "the state")
    assert (live.state["ground"]["alarms_silent_until"], live.state["ground"]["alarms_left_out"]) == (None, 0)
    client.post("/api/alarms", {"do": "silence", "agent": None, "for_s": 600})
    until(lambda: live.state["ground"]["alarms_silent_until"], "the silence")
    client.post("/api/alarms", {"do": "unsilence", "agent": None})
    until(lambda: live.state["ground"]["alarms_silent_until"] is None, "its end")


def test_the_stream_and_the_snapshot_of_serve_are_there_as_well(here: Ground) -> None:
    """With the keys of gcs.md."""
    vehicle = here.vehicle(16)
    vehicle.heartbeat()
    until(lambda: "A16" in [agent["name"] for agent in here.client().get("/snapshot")["agents"]], "the agent")
    assert "age_s" in here.client().get("/snapshot")["agents"][0]
