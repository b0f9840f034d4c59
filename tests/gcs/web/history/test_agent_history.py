"""The history of `phm status --web`: what one agent's page has shown comes back after a restart of the page."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Stamp
from phm.core.settings import Settings
from phm.gcs.web import agent_row
from phm.gcs.web.history.locations import STATE_DIR, agent_path
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.status_recorder import StatusRecorder
from phm.gcs.web.history.store import EVENT, HistoryRow, HistorySample, HistoryStore
from phm.wire import status_file
from phm.wire.report import iso
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.gcs.web.swarm import Client
from tests.gcs.web.test_agent_page import OPENED_S, Written, document

Json = dict[str, Any]
NODE = "nodes/agent_1/node_1"


@pytest.fixture(autouse=True)
def _current(monkeypatch: pytest.MonkeyPatch) -> None:
    """No daemon writes its status again, so it is current for longer than a test may take."""
    monkeypatch.setattr(status_file, "MAX_AGE_S", 3600.0)


@contextlib.contextmanager
def page(folder: Path, history: Path | None, **changes: Any) -> Iterator[Written]:
    made = Written(folder, history=history, **changes)
    try:
        yield made
    finally:
        made.page.close()


def words(client: Client, query: str = "agent=A07") -> list[str]:
    return [event["words"] for event in client.get(f"/api/history/events?{query}")["events"]]


def faults(client: Client) -> list[Json]:
    return list(client.get("/api/history/faults?agent=A07")["faults"])


def known(client: Client, part: str) -> bool:
    """Whether an event is in the history."""
    status, body, _ = client.ask("GET", "/api/history/events?agent=A07")
    return status == 200 and any(part in event["words"] for event in body["events"])


def closed(**changes: Any) -> Json:
    """`faults` of a status in which the fault of `document` has ended."""
    (fault,) = document()["faults"]["open"]
    ended = {**fault, "closed": iso(OPENED_S + 3.9), "duration_s": 3.9, "outcome": "resolved", "by": "restart"}
    return {"open": [], "given_up": [], "closed": [{**ended, **changes}]}


def test_events_faults_flight_and_plots_survive_a_restart(tmp_path: Path) -> None:
    """The second page has what the first one saw, and ends the fault that the first one saw begin."""
    history = tmp_path / "state" / "page-history.db"
    with page(tmp_path, history, armed=False) as first:
        until(lambda: known(first.client, "disarmed"), "the state of the autopilot")
        first.write(document(armed=True))
        until(lambda: known(first.client, "is armed"), "the arming")
        assert [fault["open"] for fault in faults(first.client)] == [True]
        kinds = {one["kind"] for one in first.client.get("/api/history/kinds?agent=A07")["kinds"]}
    assert {"level", "cpu", "memory", "temperature", "topic agent_1/topic_2"} <= kinds
    assert history.stat().st_mode & 0o077 == 0
    with page(tmp_path, history, armed=True) as second:
        assert any(NODE in line for line in words(second.client))
        assert [line for line in words(second.client) if line.startswith("autopilot")] == [
            "autopilot is armed",
            "autopilot is disarmed",
        ]
        flight = second.client.get("/api/history/flight?agent=A07")
        assert flight["since"] is not None and flight["until"] is None
        for kind in sorted(kinds):
            path = f"/api/history/series?agent=A07&kind={kind.replace(' ', '%20')}&since=0"
            assert second.client.get(path)["points"], kind
        second.write(document(armed=True, faults=closed()))
        until(lambda: not faults(second.client)[0]["open"], "the end of the fault")
        (fault,) = faults(second.client)
        assert [step["step"] for step in fault["steps"]] == ["confirmed", "action", "proof"]


def test_a_fault_while_the_page_was_down_is_in_the_history_once(tmp_path: Path) -> None:
    """The status lists the last faults; each page adds those that the history does not have."""
    history = tmp_path / "history.db"
    for _ in range(2):
        with page(tmp_path, history, faults=closed()) as here:
            until(lambda here=here: known(here.client, "resolved by restart"), "the fault")  # type: ignore[misc]
    reader = HistoryReader(history)
    assert [body["open"] for body in reader.faults("A07")["faults"]] == [False]
    with page(tmp_path, history, faults=closed()) as here:
        assert len([line for line in words(here.client, "event=fault") if line.startswith("fault ended")]) == 1


def test_a_history_that_cannot_be_written_is_a_note_on_a_page_that_works(tmp_path: Path) -> None:
    """As on a read-only volume; live events are still sent."""
    (tmp_path / "file").write_text("not a folder")
    with page(tmp_path, tmp_path / "file" / "folder" / "history.db") as here:
        until(lambda: here.client.get("/api/state")["ground"]["history"]["problem"], "the note")
        state = here.client.get("/api/state")
        assert "the history cannot be written: Not a directory" in state["ground"]["history"]["problem"]
        assert state["agents"]["A07"]["checks"] and "cannot be written" in here.page.about()
        here.client.get("/api/history/events?agent=A07", 503)


def test_the_history_of_a_killed_page_returns(tmp_path: Path) -> None:
    """`phm status --web --history FILE` over HTTP: killed after an event was stored, and started again."""
    port, stop = free_port(), threading.Event()

    def write() -> None:
        """As a daemon does: a status is valid for a few seconds."""
        while not stop.wait(0.2):
            (tmp_path / "new").write_text(json.dumps(document()), encoding="utf-8")
            (tmp_path / "new").replace(tmp_path / status_file.NAME)

    def start() -> subprocess.Popen[bytes]:
        options = ["--run-dir", str(tmp_path), "--web", str(port), "--history", str(tmp_path / "history.db")]
        return subprocess.Popen(
            [sys.executable, "-m", "phm.cli", "status", *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    client, writer = Client(("127.0.0.1", port)), threading.Thread(target=write, daemon=True)
    writer.start()
    process = start()
    try:
        until(lambda: reached(client, NODE), "the event")
        process.kill()
        process.wait(120)
        process = start()
        until(lambda: reached(client, NODE), "the event of the first run")
        assert len([line for line in words(client, "event=fault") if NODE in line]) == 1
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
    finally:
        stop.set()
        writer.join(120)
        process.kill()
        process.wait(120)


def reached(client: Client, part: str) -> bool:
    with contextlib.suppress(OSError):
        return known(client, part)
    return False


class CountedClock(SystemClock):
    """Counts the waits of the store's thread, each a turn of its loop, and does not wait long."""

    turns = 0

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.turns += threading.current_thread().name == "phm-gcs-history"
        return super().wait(event, None if timeout_s is None else min(timeout_s, 0.01))


def test_samples_wait_while_no_browser_looks_and_events_do_not(tmp_path: Path) -> None:
    """An SD card wears out by each write."""
    clock = CountedClock()
    store = HistoryStore(tmp_path / "history.db", clock, idle_s=1e9)
    store.start()
    try:
        until(lambda: store.path.exists() and clock.turns > 2, "the file")

        def turns() -> None:
            seen = clock.turns
            until(lambda: clock.turns > seen + 3, "the loop")

        store.put(HistorySample("A07", "cpu", 1.0, 5.0))
        turns()
        assert store.waiting == 1
        store.put(HistoryRow(EVENT, (2.0, "A07", 0, "hold", "on hold", "{}")))
        until(lambda: store.waiting == 0, "the event")
        store.put(HistorySample("A07", "cpu", 3.0, 5.0))
        turns()
        assert store.waiting == 1
        store.watched = True
        until(lambda: store.waiting == 0, "the sample")
    finally:
        store.close()


class Recorded:
    """A recorder without a page; `take` returns the words of the events of a status."""

    def __init__(self) -> None:
        self._store = HistoryStore(None, SystemClock())
        self._recorder = StatusRecorder(self._store, HistoryReader(self._store.path))
        self._at = 1000.0

    def take(self, content: Json, problem: str = "") -> list[str]:
        self._at += 1
        row = agent_row.row(content, problem)
        return [event["words"] for event in self._recorder.take(content, row, Stamp(1.7e9 + self._at, self._at))]

    def close(self) -> None:
        self._store.close()


@pytest.fixture
def recorded() -> Iterator[Recorded]:
    made = Recorded()
    yield made
    made.close()


def test_what_changes_is_an_event(recorded: Recorded) -> None:
    """Warnings, holds, a lost PHM, its reload and its restart; what was so when the page started is none."""
    quiet = {"faults": {"open": [], "given_up": [], "closed": []}, "holds": [], "health": {"started_utc": 4.0}}
    checks = document()["checks"]
    warned = [{**one, "level": "WARN", "summary": "hot"} if one["id"] == "host/cpu" else one for one in checks]
    held = {"container": "ros_app", "until": "", "left_s": 60.0, "by": "operator", "reason": "landing gear"}
    assert recorded.take(document(**quiet)) == []
    assert recorded.take(document(**quiet, checks=warned)) == ["host/cpu WARN: hot"]
    assert recorded.take(document(**quiet)) == ["host/cpu OK: CPU at 10 %"]
    assert recorded.take(document(**{**quiet, "holds": [held]})) == ["on hold: ros_app by operator: landing gear"]
    assert recorded.take(document(**quiet)) == ["no longer on hold: ros_app by operator"]
    assert recorded.take({}, "there is no status") == ["A07 is lost: there is no status"]
    assert recorded.take({}, "there is no status") == []
    assert recorded.take(document(**quiet)) == ["A07 PHM works again"]
    assert recorded.take(document(**quiet, boot_id="another")) == ["A07 PHM has reloaded its configuration"]
    later = {**quiet, "health": {"started_utc": 5.0}}
    assert recorded.take(document(**later, boot_id="third")) == ["A07 PHM has restarted"]


def test_a_fault_that_recovery_gave_up_on_stays_open_until_it_is_no_longer_bad(recorded: Recorded) -> None:
    """Its end is then an event."""
    (fault,) = document()["faults"]["open"]
    ended = {**fault, "closed": iso(OPENED_S + 35.0), "duration_s": 35.0, "outcome": "escalated"}
    assert len(recorded.take(document())) == 1
    given_up = {"open": [], "given_up": [{**fault, "outcome": "escalated"}], "closed": [ended]}
    assert recorded.take(document(faults=given_up)) == ["fault ab12-1: recovery has given up on it"]
    assert recorded.take(document(faults=given_up)) == []
    (words,) = recorded.take(document(faults={**given_up, "given_up": []}))
    assert words.startswith("fault ended: no longer bad")
    assert recorded.take(document(faults={**given_up, "given_up": []})) == []


def test_hostile_texts_of_a_status_are_one_line_of_bounded_length(recorded: Recorded) -> None:
    """Also in what is stored."""
    wicked = "</script>\n\x1b[2J" + "x" * 10_000
    (fault,) = document()["faults"]["open"]
    open_fault = {**fault, "unit": wicked, "summary": wicked, "opened": wicked, "slot": "x"}
    (said,) = recorded.take(document(faults={"open": [open_fault], "given_up": [], "closed": []}))
    assert len(said) <= agent_row.MAX_TEXT and not {"\n", "\x1b"} & set(said)


def test_the_history_is_in_the_state_folder_of_its_owner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM's user uses PHM's folder; another user, and a machine without one, the folder of that user."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
    assert agent_path(tmp_path) == tmp_path / "page-history.db"
    own = tmp_path / "home" / "phm" / "page-history.db"
    assert agent_path(tmp_path / "none") == own
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert agent_path(tmp_path) == own
    assert str(STATE_DIR) == Settings.model_fields["state_dir"].default
