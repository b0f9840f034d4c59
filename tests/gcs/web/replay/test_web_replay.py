"""A record is shown by the same page: at any speed, with pause and jumps, and without requests."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.core.clock import SystemClock
from phm.core.model import Level, Slot
from phm.gcs.events import GcsEvent, encode
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.replay import record as record_module
from phm.gcs.web.replay.page import ReplayPage
from phm.gcs.web.replay.record import RecordError, load
from tests.fakes.until import until
from tests.gcs.bench import Ground, autopilot, phm_heartbeat, text_frame
from tests.gcs.web.swarm import Client, Live

FAILED = {Slot.CONTAINER: Level.ERROR}


def flight(path: Path, *, runs: int = 1) -> None:
    """A record of 2 minutes: agent 7 fails after 30 s and recovers after 60 s, agent 8 is lost after 90 s."""
    lines: list[bytes] = []
    for run in range(runs):
        ground = Ground()
        ground.clock.advance(run * 3600)
        found = [
            GcsEvent(ground.clock.stamp(), "start", {"version": "x", "system": 254, "component": 190, "links": []})
        ]
        seven, eight = phm_heartbeat(7), phm_heartbeat(8)
        found += ground.receive(seven, eight, autopilot(7, armed=True))
        found += ground.wait(30, seven, eight, autopilot(7, armed=True))
        found += ground.receive(phm_heartbeat(7, FAILED), text_frame(7, "A07 FAIL 2 ros_app exited 1"))
        found += ground.wait(30, phm_heartbeat(7, FAILED), eight, autopilot(7, armed=True))
        found += ground.receive(seven, text_frame(7, "A07 OK 2 ros_app restarted", 5))
        found += ground.wait(30, seven, eight, autopilot(7, armed=True))
        found += ground.wait(30, seven, autopilot(7, armed=True))
        found += [GcsEvent(ground.clock.stamp(), "end", {})]
        lines += [encode(event, f"run{run}", number) for number, event in enumerate(found, 1)]
    path.write_bytes(b"\n".join(lines) + b"\n")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[ReplayPage]:
    path = tmp_path / "flight.jsonl"
    flight(path)
    made = ReplayPage(load(path), ListenOptions(port=0), SystemClock(), speed=0.1)
    made.start()
    until(lambda: served(made), "the page")
    yield made
    made.close()


def served(page: ReplayPage) -> bool:
    try:
        return Client(page.address).ask("GET", "/api/state")[0] == 200
    except OSError:
        return False


@pytest.fixture
def live(page: ReplayPage) -> Iterator[Live]:
    made = Live(Client(page.address))
    until(lambda: made.state, "the state")
    yield made
    made.close()


@pytest.fixture
def client(page: ReplayPage) -> Client:
    made = Client(page.address)
    made.session()
    return made


def seek(client: Client, live: Live, seconds: float) -> None:
    """To this many seconds after the begin."""
    before = len(live.of("full"))
    begin = live.state["ground"]["replay"]["from_utc"]
    client.post("/api/replay", {"do": "pause"})
    client.post("/api/replay", {"do": "seek", "utc": begin + seconds})
    until(lambda: len(live.of("full")) > before, "the new state")


def shown(client: Client, live: Live, seconds: float, *words: str) -> None:
    """After a jump agents 7 and 8 are so; a state from before the jump may arrive first."""
    seek(client, live, seconds)
    until(lambda: (live.agent("A07").get("how"), live.agent("A08").get("how")) == words, f"{words}", lambda: live.state)


def test_a_jump_shows_the_state_of_that_moment(client: Client, live: Live) -> None:
    """Forwards and backwards; heartbeats that changed nothing are filled in, so no agent is lost by the record's gaps."""
    shown(client, live, 20, "OK", "OK")
    shown(client, live, 45, "ERROR", "OK")
    assert live.agent("A07")["bad"][0]["text"] == "ros_app exited 1"
    shown(client, live, 118, "OK", "LOST")
    assert live.state["now"] - live.agent("A08")["at"] == pytest.approx(28, abs=3)
    shown(client, live, 20, "OK", "OK")


def test_a_replay_runs_at_any_speed_and_stops_at_the_end(client: Client, live: Live) -> None:
    """With the events of the record, at their own times."""
    # Else it may have ended before the last request, which then begins again.
    client.post("/api/replay", {"do": "pause"})
    client.post("/api/replay", {"do": "speed", "speed": 1000})
    client.post("/api/replay", {"do": "play"})
    until(lambda: [event for event in live.events() if event["event"] == "end"], "the last event")
    until(lambda: live.state["ground"]["replay"]["playing"] is False, "the end")
    said = [event["text"] for event in live.events() if event["event"] == "text"]
    assert said == ["A07 FAIL 2 ros_app exited 1", "A07 OK 2 ros_app restarted"]
    until(lambda: live.agent("A08").get("how") == "LOST", "the loss")
    assert live.state["ground"]["rate"] == 0
    client.post("/api/replay", {"do": "play"})
    until(lambda: live.state["ground"]["replay"]["playing"] or len(live.of("full")) > 1, "it from the begin")


def test_the_history_ends_at_the_time_that_is_shown(client: Client, live: Live) -> None:
    """The future of the record is not known yet."""
    seek(client, live, 10)
    assert client.get("/api/history/faults?agent=A07")["faults"] == []
    assert client.get("/api/history/events?q=exited")["events"] == []
    seek(client, live, 110)
    until(lambda: client.get("/api/history/events?q=exited")["events"], "the event")

    def steps() -> list[list[str]]:
        found = client.get("/api/history/faults?agent=A07")["faults"]
        return [[step["step"] for step in fault["steps"]] for fault in found]

    until(lambda: steps()[:1] == [["confirmed", "action", "proof"]], "the fault", steps)


def test_a_fault_is_shown_as_it_was_at_the_time_that_is_shown(client: Client, live: Live) -> None:
    """Before its end it is open, without the steps that follow; after it, it has ended."""

    def found(query: str) -> list[tuple[bool, float | None, list[str]]]:
        listed = client.get(f"/api/history/faults?agent=A07&{query}")["faults"]
        return [(one["open"], one["ended_utc_s"], [step["step"] for step in one["steps"]]) for one in listed]

    seek(client, live, 45)
    until(lambda: found(""), "the history")
    assert found("open=1") == found("") == [(True, None, ["confirmed"])]
    seek(client, live, 110)
    begin = live.state["ground"]["replay"]["from_utc"]
    ended = pytest.approx(begin + 60, abs=2)
    whole = [(False, ended, ["confirmed", "action", "proof"])]
    until(lambda: found(f"since={begin + 50}") == whole, "its end", lambda: found(f"since={begin + 50}"))
    assert found("open=1") == []
    assert found(f"since={begin + 100}") == []
    seek(client, live, 45)
    assert found("open=1") == [(True, None, ["confirmed"])]


def test_requests_are_refused(client: Client, live: Live) -> None:
    """There is no agent; wrong controls are refused, too."""
    assert "a record is being replayed" in client.post("/api/requests", {"agent": "A07", "do": "check"}, 409)["error"]
    assert "a record is being replayed" in client.get("/api/choices?agent=A07")["note"]
    for body in ({"do": "rewind"}, {"do": "seek"}, {"do": "speed", "speed": 0}, {"do": "speed", "speed": True}):
        assert client.post("/api/replay", body, 400)["error"]


def test_runs_follow_each_other_without_the_time_between(tmp_path: Path) -> None:
    """A record that was continued an hour later is not an hour of silence; moments have their own UTC."""
    path = tmp_path / "flight.jsonl"
    flight(path, runs=2)
    record = load(path)
    assert 240 <= record.end <= 245
    assert record.utc(record.end) - record.utc(0.0) == pytest.approx(3600 + 120, abs=2)
    assert record.at(record.utc(200.0)) == pytest.approx(200.0)


def test_damaged_lines_are_skipped(tmp_path: Path) -> None:
    """Torn, foreign and wrongly typed lines; what is left is shown."""
    path = tmp_path / "flight.jsonl"
    flight(path)
    lines: list[Any] = path.read_bytes().splitlines()
    head = json.loads(lines[3])
    wrong = [
        {**head, "event": "slots", "name": "<b>", "word": "x", "state": 5},
        {**head, "event": "view", "name": "A07", "peers": [1]},
        {**head, "event": "digest", "name": "A07", "levels": {"x": 1}},
        {**head, "mono": "late"},
        {**head, "utc_s": 1e300},
        {**head, "event": 5},
    ]
    lines[4:4] = [json.dumps(line).encode() for line in wrong] + [b"\x00\x00", b'{"torn', b"[]"]
    path.write_bytes(b"\n".join(lines))
    assert load(path).end == pytest.approx(120, abs=3)
    (tmp_path / "none.jsonl").write_text("hello\n")
    for name, words in (("none.jsonl", "no line of"), ("missing.jsonl", "no such file")):
        with pytest.raises(RecordError, match=words):
            load(tmp_path / name)


def test_no_line_of_a_record_stops_the_page(tmp_path: Path) -> None:
    """Numbers that JSON does not have, half characters, and values out of range: the rest is shown, and a jump succeeds."""
    path = tmp_path / "flight.jsonl"
    flight(path)
    lines = path.read_bytes().splitlines()
    head = json.loads(lines[3])
    text = {
        **head,
        "event": "text",
        "system": 7,
        "component": 193,
        "severity": 2,
        "text": "A07 FAIL 2 x y",
        "phm": True,
    }
    wrong = [
        {**head, "event": "start", "system": 254, "component": "x"},
        {**head, "event": "slots", "name": "A07", "word": float("inf"), "state": "active"},
        {**head, "event": "digest", "name": "A07", "members": 10**9, "alive": 1, "levels": {"7": "OK"}},
        {**head, "event": "presence", "name": "A08", "presence": "lost", "silent_s": "inf"},
        {**head, "event": "presence", "name": "A08", "presence": "lost", "silent_s": -1e300},
        {**head, "event": "lost", "lines": float("nan")},
        {**head, "event": "presence", "name": "\ud800", "presence": "alive"},
        {**text, "seq": "x", "repeat": False, "kind": "change"},
        {**text, "mono": 1e11},
    ]
    lines[4:4] = [json.dumps(line).encode() for line in wrong]
    path.write_bytes(b"\n".join(lines))
    record = load(path)
    assert record.end == pytest.approx(120, abs=3)
    made = ReplayPage(record, ListenOptions(port=0), SystemClock(), speed=0.1)
    try:
        made.start()
        until(lambda: served(made), "the page")
        client = Client(made.address)
        client.session()
        client.post("/api/replay", {"do": "seek", "utc": record.utc(record.end)})
        until(lambda: client.get("/api/state")["agents"].get("A07", {}).get("how") == "OK", "the end of the record")
        until(lambda: client.get("/api/history/events?q=exited")["events"], "the events")
        assert not client.get("/api/state")["ground"]["history"]["problem"]
    finally:
        made.close()


def test_a_record_of_too_many_heartbeats_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small file must not fill the memory: what is filled in between its lines is counted."""
    monkeypatch.setattr(record_module, "MAX_LINES", 5000)
    path = tmp_path / "flight.jsonl"
    path.write_text(
        "".join(
            json.dumps(
                {"run": "r", "seq": one, "utc_s": 1e9 + at, "mono": at, "event": "slots"}
                | {"name": f"A{one % 9 + 1}", "word": 1, "state": "4"}
            )
            + "\n"
            for one, at in enumerate(range(0, 20_000, 1000))
        )
    )
    with pytest.raises(RecordError, match="more than 5000 heartbeats"):
        load(path)


def test_the_time_since_arming_is_that_of_the_record(client: Client, live: Live) -> None:
    """A jump does not move it."""
    begin = live.state["ground"]["replay"]["from_utc"]
    query = "/api/history/series?agent=A07&kind=level&since=armed"
    for seconds in (100, 45):
        seek(client, live, seconds)
        until(lambda: client.ask("GET", query)[0] == 200, "the arming")
        points = until(lambda: client.get(query)["points"], "the levels")
        assert points[0][0] == pytest.approx(begin, abs=2)
        assert client.get("/api/history/flight?agent=A07")["since"] == pytest.approx(begin, abs=2)


def test_levels_have_a_series(client: Client, live: Live) -> None:
    """Up to the moment that is shown; heartbeat gaps are not made up."""
    seek(client, live, 45)
    kinds = until(lambda: client.get("/api/history/kinds?agent=A07")["kinds"], "the series")
    assert [one["kind"] for one in kinds] == ["level"]

    def levels(name: str) -> list[float]:
        points = client.get(f"/api/history/series?agent={name}&kind=level")["points"]
        return [value for _, value, _ in points if value is not None]

    until(lambda: levels("A07")[-1:] == [3.0], "the failure")
    assert levels("A07")[0] == 1.0
    seek(client, live, 118)
    until(lambda: (levels("A07")[-1:], levels("A08")[-1:]) == ([1.0], [0.0]), "the end")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--replay", "/none"), "--replay needs --web"),
        (("--replay", "/none", "--web", "0"), "there is no such file"),
        (("--replay", "/none", "--web", "0", "--once"), "cannot be used with"),
        (("--replay", "/none", "--web", "0", "--serve", "0"), "cannot be used with"),
        (("--replay", "/none", "--web", "0.0.0.0:0"), "add --token-file"),
        (("--web", "0", "--speed", "10"), "--speed needs --replay"),
    ],
)
def test_a_mistake_is_explained(arguments: tuple[str, ...], words: str) -> None:
    """Before anything is served."""
    result = CliRunner().invoke(group, ["gcs", *arguments])
    assert result.exit_code in (1, 2)
    assert words in result.output


def test_the_command_serves_the_record(tmp_path: Path) -> None:
    """And ends with `--for`."""
    path = tmp_path / "flight.jsonl"
    flight(path)
    result = CliRunner().invoke(group, ["gcs", "--replay", str(path), "--web", "0", "--speed", "10", "--for", "0.5"])
    assert result.exit_code == 0, result.output
    assert f"replay of {path}, 120 s" in result.output
