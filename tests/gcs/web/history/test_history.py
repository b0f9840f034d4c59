"""What the page remembers: over a restart, with limits, and from a damaged file it goes on with a new one."""

from __future__ import annotations

import json
import math
import sqlite3
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Level, Slot
from phm.gcs.presence import COPY_S
from phm.gcs.web.history.collector import MAX_TOPICS
from phm.gcs.web.history.faults import FaultList, as_of
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.store import EVENT, FAULT, HistoryRow, HistorySample, HistoryStore
from phm.transport.dialect import mavlink
from tests.fakes.until import until
from tests.gcs.web.swarm import Client, ground

FAILED = {Slot.CONTAINER: Level.ERROR}


def faults(client: Client, query: str = "agent=A07") -> list[dict[str, Any]]:
    return list(client.get(f"/api/history/faults?{query}")["faults"])


def steps(client: Client) -> list[str]:
    found = faults(client)
    return [step["step"] for step in found[0]["steps"]] if found else []


def events(client: Client, query: str) -> list[dict[str, Any]]:
    return list(client.get(f"/api/history/events?{query}")["events"])


def test_samples_events_and_open_faults_survive_a_restart(tmp_path: Path) -> None:
    """The second run adds to what the first one has written, and ends the fault that the first one saw begin."""
    path = tmp_path / "deep" / "history.db"
    with ground(history=path) as first:
        vehicle, client = first.vehicle(), first.client()
        until(lambda: path.exists(), "the file")
        for _ in range(3):
            vehicle.heartbeat(FAILED)
            end = time.monotonic() + COPY_S * 1.5  # a shorter gap would count as a copy
            until(lambda end=end: time.monotonic() > end, "time to pass")  # type: ignore[misc]
        vehicle.say("A07 FAIL 2 ros_app exited 1")
        vehicle.say("A07 ADVISE 2 restart ros_app #17 60s", 4)
        until(lambda: steps(client) == ["confirmed", "advised"], "the fault")
        gaps = until(lambda: client.get("/api/history/series?agent=A07&kind=gap")["points"], "the gaps")
        assert all(0.1 < value < 600 for _, value, _ in gaps)
    assert path.stat().st_mode & 0o077 == 0
    with ground(history=path) as second:
        vehicle, client = second.vehicle(), second.client()
        until(lambda: events(client, "agent=A07&q=exited"), "the event of the first run")
        vehicle.heartbeat()
        vehicle.say("A07 OK 2 ros_app restarted", 5)
        until(lambda: steps(client)[-2:] == ["action", "proof"], "the end", lambda: steps(client))
        assert [fault["open"] for fault in faults(client)] == [False]
        assert faults(client, "agent=A07&open=1") == []
        assert len(client.get("/api/history/series?agent=A07&kind=gap")["points"]) >= len(gaps)


def test_a_fault_that_has_ended_is_listed_since_a_moment() -> None:
    """Open faults, and those that ended after it; with the time of their end."""
    with ground() as here:
        vehicle, client = here.vehicle(), here.client()
        vehicle.heartbeat()
        before = here.clock.utc()
        vehicle.say("A07 FAIL 2 ros_app exited 1")
        vehicle.say("A07 FAIL 6 planner dead")
        vehicle.say("A07 OK 2 ros_app restarted", 5)
        until(lambda: len(faults(client, "open=1")) == 1 == len(faults(client)) - 1, "the end", lambda: faults(client))

        def listed(since: float) -> list[tuple[str, bool]]:
            return [(one["unit"], one["open"]) for one in faults(client, f"agent=A07&since={since}")]

        assert sorted(listed(before)) == [("planner", True), ("ros_app", False)]
        assert listed(here.clock.utc() + 1) == [("planner", True)]
        ended = {one["unit"]: one["ended_utc_s"] for one in faults(client)}
        assert ended["planner"] is None and before <= ended["ros_app"] <= here.clock.utc()


def first_since_arming(client: Client) -> float | None:
    """UTC seconds of the first sample of the series; None: refused."""
    status, body, _ = client.ask("GET", "/api/history/series?agent=A07&kind=level&since=armed")
    return body["points"][0][0] if status == 200 and body["points"] else None


def test_the_time_since_arming_survives_a_restart_and_the_landing(tmp_path: Path) -> None:
    """It begins when the autopilot was armed; the last flight stays after its end, until the next arming."""
    path = tmp_path / "history.db"
    with ground(history=path) as first:
        vehicle, client = first.vehicle(), first.client()
        vehicle.heartbeat()
        vehicle.autopilot(armed=False)
        until(lambda: events(client, "agent=A07&event=autopilot"), "the autopilot")
        assert first_since_arming(client) is None
        vehicle.autopilot(armed=True)
        vehicle.heartbeat(FAILED)
        begin = until(lambda: first_since_arming(client), "a sample after the arming")
    with ground(history=path) as second:
        vehicle, client = second.vehicle(), second.client()
        known = len(events(client, "agent=A07&event=autopilot"))
        vehicle.heartbeat()
        vehicle.autopilot(armed=True)
        until(lambda: len(events(client, "agent=A07&event=autopilot")) > known, "the autopilot in flight")
        assert first_since_arming(client) == begin
        flight = client.get("/api/history/flight?agent=A07")
        assert round(flight["since"], 3) <= begin and flight["seen"] and flight["until"] is None
        vehicle.autopilot(armed=False)
        landed = until(lambda: client.get("/api/history/flight?agent=A07")["until"], "the landing")
        assert client.get("/api/history/flight?agent=A07") == {**flight, "until": landed}
        assert first_since_arming(client) == begin
        vehicle.autopilot(armed=True)
        until(lambda: client.get("/api/history/flight?agent=A07")["since"] >= landed, "the next flight")


def test_a_flight_does_not_continue_over_a_time_without_the_ground(tmp_path: Path) -> None:
    """Nothing is known of that time; without a disarmed autopilot before it, the arming was not received."""
    path, clock = tmp_path / "history.db", SystemClock()
    store, reader, begin = HistoryStore(path, clock), HistoryReader(path), clock.utc() - 10_000
    store.start()

    def autopilot(at: float, *, armed: bool) -> None:
        body = json.dumps({"utc_s": begin + at, "armed": armed})
        store.put(HistoryRow(EVENT, (begin + at, "A07", 0, "autopilot", "", body)))

    def flight(at: float) -> tuple[float | None, float | None, bool]:
        found = reader.flight("A07", begin + at)
        since, end = (None if found[key] is None else round(found[key] - begin) for key in ("since", "until"))
        return since, end, found["seen"]

    for at in range(0, 3000, 10):
        store.put(HistorySample("A07", "rate", begin + at, 4.0))
    autopilot(5, armed=False)
    autopilot(1000, armed=True)
    autopilot(2900, armed=True)
    autopilot(5000, armed=True)
    autopilot(5100, armed=False)
    autopilot(5200, armed=False)
    assert store.flush(120)
    until(lambda: flight(6000)[0], "the flight")
    store.close()
    assert flight(1) == flight(10) == (None, None, False)
    assert flight(2950) == (1000, None, True)
    assert flight(5050) == (5000, None, False)
    assert flight(6000) == (5000, 5100, False)
    assert reader.flight("A08")["since"] is None


def test_events_are_found_by_text_grade_agent_and_page(tmp_path: Path) -> None:
    """Newest first; what is asked for is a value, never part of the query."""
    with ground() as here:
        one, two, client = here.vehicle(7), here.vehicle(8), here.client()
        one.heartbeat()
        two.heartbeat()
        one.say("A07 FAIL 2 ros_app exited 1")
        two.say("A08 WARN 9 disk / 88%", 4)
        until(lambda: len(events(client, "event=text")) == 2, "both lines", lambda: events(client, "event=text"))
        assert [event["who"] for event in events(client, "q=DISK&event=text")] == ["A08"]
        assert [event["who"] for event in events(client, "grade=critical")] == ["A07"]
        assert events(client, "q=%25&agent=A07") == []
        assert events(client, "agent=A07%27%20OR%201=1--") == []
        newest = client.get("/api/history/events?limit=1")
        assert newest["more"] is True
        older = events(client, f"before={newest['events'][0]['id']}&limit=500")
        assert newest["events"][0]["id"] not in {event["id"] for event in older}


@pytest.mark.parametrize(
    "query",
    [
        "series?agent=A07&kind=gap&since=nan",
        "series?agent=A07&kind=gap&since=5&until=1",
        "events?before=x",
        "events?limit=many",
        f"events?q={'x' * 300}",
    ],
)
def test_a_wrong_query_is_refused(query: str) -> None:
    """With 400 and a sentence."""
    with ground() as here:
        assert here.client().get(f"/api/history/{query}", 400)["error"]


def test_a_damaged_file_is_set_aside(tmp_path: Path) -> None:
    """The page says so, and records from now on."""
    path = tmp_path / "history.db"
    path.write_bytes(b"not a database at all" * 1000)
    with ground(history=path) as here:
        here.vehicle().heartbeat()
        client = here.client()
        until(lambda: events_or_none(client), "the new history")
        problem = until(lambda: client.get("/api/state")["ground"]["history"]["problem"], "the note")
        assert "a new one was started" in problem
        assert "a new one was started" in here.page.about()
    assert [one.read_bytes()[:5] for one in tmp_path.glob("history.db.damaged-*")] == [b"not a"]


@pytest.mark.parametrize("numbers", [(0, 0), (0, 7), (0x47504B47, 0)])
def test_a_database_of_another_program_is_left_alone(tmp_path: Path, numbers: tuple[int, int]) -> None:
    """Not one byte of it is changed, it is not renamed, and the page works without a history and says why."""
    path = tmp_path / "photos.db"
    other = sqlite3.connect(path)
    other.executescript(
        f"PRAGMA application_id = {numbers[0]}; PRAGMA user_version = {numbers[1]}; "
        "CREATE TABLE event (id INTEGER PRIMARY KEY, body TEXT); INSERT INTO event (body) VALUES ('mine')"
    )
    other.close()
    before = path.read_bytes()
    with ground(history=path) as here:
        here.vehicle().heartbeat()
        client = here.client()
        problem = until(lambda: client.get("/api/state")["ground"]["history"]["problem"], "the note")
        assert "another program" in problem and str(path) in problem
        assert client.ask("GET", "/api/history/events")[0] != 200
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["photos.db"]


def test_an_empty_file_becomes_a_history(tmp_path: Path) -> None:
    """As `mktemp` makes it; it says whose it is before anything else is in it."""
    path = tmp_path / "history.db"
    path.touch()
    for _ in range(2):
        store = HistoryStore(path, SystemClock())
        store.start()
        until(lambda: HistoryReader(path).faults("") == {"faults": []}, "the tables")
        assert store.problem() == ""
        store.close()
    assert [each.name for each in tmp_path.iterdir()] == ["history.db"]


def events_or_none(client: Client) -> Any:
    status, body, _ = client.ask("GET", "/api/history/events")
    return body["events"] if status == 200 else None


def test_damaged_entries_do_not_stop_the_page(tmp_path: Path) -> None:
    """A file that SQLite can read may have entries that are none: the page starts, and shows the others."""
    path = tmp_path / "history.db"
    store = HistoryStore(path, SystemClock())
    store.start()
    for key, body in (("1", "{torn"), ("2", "[]"), ("3", '{"key": "3"}'), ("4", '{"steps": [{}]}')):
        store.put(HistoryRow(FAULT, (key, "A07", time.time(), time.time(), 1, body)))
        store.put(HistoryRow(EVENT, (time.time(), "A07", 1, "text", "exited", body)))
    assert store.flush(120)
    store.close()
    with ground(history=path) as made:
        client = made.client()
        assert [one.get("key") for one in faults(client)] == [None, "3"]
        assert len(events(client, "q=exited")) == 2


def test_an_entry_that_cannot_be_kept_is_left_out(tmp_path: Path) -> None:
    """It is counted; the entries beside it are kept, and the file is not taken for damaged."""
    path = tmp_path / "history.db"
    store = HistoryStore(path, SystemClock())
    store.start()
    good = (time.time(), "A07", 1, "text", "exited", "{}")
    for values in (
        good,
        (*good[:4], "\ud800", "{}"),
        (None, *good[1:]),
        (2**70, *good[1:]),
        (*good[:4], object(), "{}"),
        good,
    ):
        store.put(HistoryRow(EVENT, values))
    until(lambda: store.waiting == 0 and "4 entries" in store.problem(), "the count", store.problem)
    store.close()
    assert (
        len(
            HistoryReader(path).events(who="", event="", text="", grade="", before=None, until=math.inf, limit=9)[
                "events"
            ]
        )
        == 2
    )
    assert not list(tmp_path.glob("*.damaged-*"))


def test_slow_queries_delay_no_request_of_an_operator(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many clients ask for the past; those that cannot wait any more are refused."""
    go_on, asked = threading.Event(), list[int]()

    def slow(reader: HistoryReader, who: str) -> list[Any]:
        asked.append(1)
        go_on.wait(60)
        return []

    monkeypatch.setattr(HistoryReader, "kinds", slow)
    with ground() as made:
        operator, found = made.client(), list[int]()
        operator.session()
        ask = [
            threading.Thread(target=lambda: found.append(made.client().ask("GET", "/api/history/kinds?agent=A07")[0]))
            for _ in range(70)
        ]
        for one in ask:
            one.start()
        try:
            until(lambda: asked and 503 in found, "the refusals")
            assert operator.ask("POST", "/api/requests", {"agent": "A09", "do": "check"})[0] == 409
        finally:
            go_on.set()
            for one in ask:
                one.join(120)
        assert found.count(200) >= 64


def test_a_folder_that_cannot_be_written_does_not_stop_the_page(tmp_path: Path) -> None:
    """The page works without a history and says why there is none."""
    (tmp_path / "file").write_text("x")
    with ground(history=tmp_path / "file" / "history.db") as here:
        live = here.live()
        here.vehicle().heartbeat()
        until(lambda: live.agent("A07"), "the agent")
        until(lambda: "cannot be written" in live.state["ground"]["history"]["problem"], "the note")
        assert "error" in here.client().get("/api/history/events", 503)


def test_what_is_being_written_is_not_on_disk_yet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`flush` and `waiting` count it, although it is not in the queue any more."""
    begun, written, write = threading.Event(), threading.Event(), HistoryStore._write

    def slowly(store: HistoryStore, connection: sqlite3.Connection, rows: Iterable[HistorySample | HistoryRow]) -> None:
        begun.set()
        written.wait()
        write(store, connection, rows)

    monkeypatch.setattr(HistoryStore, "_write", slowly)
    store = HistoryStore(tmp_path / "history.db", SystemClock())
    store.put(HistoryRow(EVENT, (1.0, "A07", 0, "text", "line", "{}")))
    store.start()
    assert begun.wait(120)
    assert (store.flush(0.1), store.waiting) == (False, 1)
    written.set()
    assert (store.flush(120), store.waiting) == (True, 0)
    store.close()


def test_the_file_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest entries go, the newest stay."""
    monkeypatch.setattr("phm.gcs.web.history.store.PRUNE_S", 0.0)
    monkeypatch.setattr("phm.gcs.web.history.store.COMMIT_S", 0.01)
    path, clock = tmp_path / "history.db", SystemClock()
    store = HistoryStore(path, clock, max_bytes=300_000)
    store.start()
    begin = clock.utc() - 10_000
    for number in range(10_000):
        store.put(HistoryRow(EVENT, (begin + number, "A07", 0, "text", f"line {number}", '{"x":"' + "x" * 100 + '"}')))
        store.put(HistorySample("A07", "gap", begin + number, 1.0))

    def size() -> int:
        with sqlite3.connect(path) as connection:
            pages = connection.execute("PRAGMA page_count").fetchone()[0]
            return int(pages * connection.execute("PRAGMA page_size").fetchone()[0])

    until(lambda: store.flush(0.1) and size() < 600_000, "the limit", size)
    store.close()
    found = HistoryReader(path).events(who="", event="", text="", grade="", before=None, until=math.inf, limit=1)[
        "events"
    ]
    assert found[0]["id"] == 10_000


def test_a_series_is_reduced_and_keeps_its_gaps(tmp_path: Path) -> None:
    """Means with their maxima, and nothing is drawn over a time without samples."""
    path, clock = tmp_path / "history.db", SystemClock()
    store, begin = HistoryStore(path, clock), clock.utc() - 2000
    store.start()
    for number in range(1000):
        at = begin + number + (500 if number >= 500 else 0)
        store.put(HistorySample("A07", "cpu", at, 99.0 if number == 5 else 10.0))
    assert store.flush(120)
    reader = HistoryReader(path)
    until(lambda: reader.kinds("A07"), "the series")
    store.close()
    points = reader.series("A07", "cpu", begin, begin + 1600, 100)["points"]
    assert len(points) <= 101
    assert max(most for _, _, most in points if most is not None) == 99
    assert [value for _, value, _ in points].count(None) == 1
    assert reader.kinds("A07") == [{"kind": "cpu", "unit": "%", "label": "CPU"}]


def named(name: str, value: float) -> Any:
    return mavlink.MAVLink_named_value_float_message(1000, name.encode("ascii"), value)


def test_the_rates_of_topics_are_kept(tmp_path: Path) -> None:
    """As series of their own with unit and label; only of agents, MAX_TOPICS of each, and none without a finite number."""
    with ground(history=tmp_path / "history.db") as here:
        live, vehicle, client = here.live(), here.vehicle(), here.client()
        vehicle.send(named("early", 1.0))
        vehicle.heartbeat()
        until(lambda: live.agent("A07"), "the agent")
        vehicle.send(named("<scan>", 9.5))
        vehicle.send(named("broken", math.nan))
        for number in range(MAX_TOPICS):
            vehicle.send(named(f"t{number}", 1.0))

        def kinds() -> dict[str, Any]:
            found = client.get("/api/history/kinds?agent=A07")["kinds"]
            return {one["kind"]: one for one in found if one["kind"].startswith("topic ")}

        last = f"topic t{MAX_TOPICS - 2}"
        until(lambda: last in kinds(), "the last series that is kept", kinds)
        assert len(kinds()) == MAX_TOPICS and "topic early" not in kinds() and "topic broken" not in kinds()
        assert kinds()["topic <scan>"] == {"kind": "topic <scan>", "unit": "Hz", "label": "rate of <scan>"}
        query = urlencode({"agent": "A07", "kind": "topic <scan>", "since": 0, "points": 10})
        found = client.get(f"/api/history/series?{query}")
        assert found["unit"] == "Hz" and [value for _, value, _ in found["points"]] == [9.5]


def line(event: str, utc_s: float, **body: Any) -> dict[str, Any]:
    return {"event": event, "utc_s": utc_s, "who": "A07", **body}


def said(text: str, utc_s: float, kind: str = "change") -> dict[str, Any]:
    return line("text", utc_s, phm=True, kind=kind, text=text)


def test_the_details_of_a_fault_say_when_it_was_detected() -> None:
    """Before it was confirmed, also across midnight."""
    book, midnight = FaultList(), 86_400.0 * 20_000
    book.take(said("A07 FAIL 2 ros_app exited 1", midnight + 2))
    found = book.take(
        line("detail", midnight + 5, fault="ab12-17", text="container/ros_app: x; open since 23:59:58 UTC")
    )
    assert [(step["step"], step["utc_s"] - midnight) for step in found[0].steps] == [("detected", -2), ("confirmed", 2)]
    assert found[0].number == 17


def test_a_fault_whose_end_was_not_received_ends_with_the_heartbeat() -> None:
    """Lines get lost; the status word is repeated."""
    book = FaultList()
    book.take(said("A07 FAIL 2 ros_app exited 1", 1))
    assert book.take(line("slots", 2, changed={"6": ["OK", "ERROR"]})) == []
    closed = book.take(line("slots", 3, changed={"2": ["ERROR", "OK"]}))
    assert [(one.open, one.steps[-1]["text"]) for one in closed] == [(False, "by its heartbeat")]


def test_a_fault_can_be_shown_as_it_was_known_at_a_moment() -> None:
    """With its level and steps of then; details that arrived later do not count, though they are about an earlier time."""
    book = FaultList()
    book.take(said("A07 WARN 2 ros_app slow", 10))
    book.take(said("A07 FAIL 2 ros_app slow", 20))
    book.take(line("detail", 30, fault="ab12-17", text="container/ros_app: x; open since 00:00:05 UTC"))
    (fault,) = book.take(said("A07 OK 2 ros_app restarted", 40))

    def shown(until: float) -> tuple[str, bool, list[str]]:
        found = as_of(fault.json(), until)
        return found["level"], found["open"], [step["step"] for step in found["steps"]]

    assert shown(15) == ("WARN", True, ["confirmed"])
    assert shown(25) == ("ERROR", True, ["confirmed", "confirmed"])
    assert shown(35) == ("ERROR", True, ["detected", "confirmed", "confirmed"])
    assert shown(45) == ("ERROR", False, ["detected", "confirmed", "confirmed", "action", "proof"])


def test_a_repeated_line_adds_no_second_fault() -> None:
    """A refresh repeats the worst one; a fault that gets worse stays one."""
    book = FaultList()
    assert len(book.take(said("A07 WARN 2 ros_app slow", 1))) == 1
    assert book.take(said("A07 WARN 11111111 2 ros_app slow", 2, "refresh")) == []
    worse = book.take(said("A07 FAIL 2 ros_app slow", 3))
    assert [(one.level, len(one.steps)) for one in worse] == [("ERROR", 2)]
    assert book.take(said("A07 OK 2 ros_app recovered", 4))[0].steps[-1]["step"] == "recovered"
