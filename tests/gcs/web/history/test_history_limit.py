"""The limits of the history: its file's holds during a flood, and no more of the older entries is deleted than is necessary."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.gcs.web.history.faults import FaultEntry
from phm.gcs.web.history.reader import MAX_FAULTS, HistoryReader
from phm.gcs.web.history.store import EVENT, FAULT, HistoryRow, HistorySample, HistoryStore
from tests.fakes.until import until

LIMIT = 1_000_000
DAY_S = 86_400.0


def size(path: Path) -> int:
    with sqlite3.connect(path) as connection:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        return int(pages * connection.execute("PRAGMA page_size").fetchone()[0])


def count(path: Path, who: str) -> int:
    with sqlite3.connect(path) as connection:
        return int(connection.execute("SELECT count(*) FROM event WHERE who = ?", (who,)).fetchone()[0])


def line(at: float, who: str) -> HistoryRow:
    return HistoryRow(EVENT, (at, who, 0, "text", "line", "x" * 400))


def test_a_flood_does_not_exceed_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of it is newer than what was there, and it comes between two of the deletions that are made each minute."""
    monkeypatch.setattr("phm.gcs.web.history.store.COMMIT_S", 0.01)
    path, clock = tmp_path / "history.db", SystemClock()
    store, now = HistoryStore(path, clock, max_bytes=LIMIT), clock.utc()
    store.start()
    for number in range(100):
        store.put(line(now - 29 * DAY_S + number * DAY_S / 4, "A01"))
    assert store.flush(120)
    for number in range(10_000):
        store.put(line(now + number / 1000, "A99"))
    until(lambda: store.flush(0.1) and size(path) <= LIMIT, "the limit", lambda: size(path))
    assert count(path, "A99") * 400 > LIMIT / 2
    store.close()


def test_no_more_is_deleted_than_is_necessary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """About a tenth of the entries, though all but a few are of the first day."""
    monkeypatch.setattr("phm.gcs.web.history.store.COMMIT_S", 0.01)
    path, clock = tmp_path / "history.db", SystemClock()
    store, now = HistoryStore(path, clock, max_bytes=LIMIT), clock.utc()
    for number in range(1900):
        store.put(line(now - 20 * DAY_S + number, "A01"))
        store.put(HistorySample("A01", "gap", now - 20 * DAY_S + number, 1.0))
    store.put(line(now, "A01"))
    store.start()
    until(lambda: store.flush(0.1) and size(path) <= LIMIT, "the limit", lambda: size(path))
    assert count(path, "A01") > 1500
    store.close()


def test_all_open_faults_are_known_after_a_start(tmp_path: Path) -> None:
    """The ground ends only those that it knows; lists of faults are shorter."""
    path, clock = tmp_path / "history.db", SystemClock()
    store, reader, now = HistoryStore(path, clock), HistoryReader(path), clock.utc()
    store.start()
    for number in range(MAX_FAULTS + 1):
        fault = FaultEntry(f"A07 {number}", "A07", 6, f"node_{number} dead", "ERROR", now + number)
        store.put(HistoryRow(FAULT, (fault.key, fault.who, fault.at, fault.at, 1, json.dumps(fault.json()))))
    assert store.flush(120)
    assert [fault.key for fault in reader.open_faults()] == [f"A07 {number}" for number in range(MAX_FAULTS + 1)]
    assert len(reader.faults("A07")["faults"]) == MAX_FAULTS
    store.close()


def test_what_was_written_survives_a_power_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each commit is synced: in WAL mode, SQLite does so with FULL (2) only."""
    opened = list[sqlite3.Connection]()

    def connect(*given: Any, real: Any = sqlite3.connect, **more: Any) -> sqlite3.Connection:
        opened.append(real(*given, **more, check_same_thread=False))
        return opened[-1]

    monkeypatch.setattr(sqlite3, "connect", connect)
    store = HistoryStore(tmp_path / "history.db", SystemClock())
    store.start()
    assert store.flush(120)
    assert opened[0].execute("PRAGMA synchronous").fetchone() == (2,)
    store.close()


class SteppedClock(SystemClock):
    """Its UTC can be set; `ahead` is how far it is ahead of this machine's."""

    ahead = 0.0

    def utc(self) -> float:
        return super().utc() + self.ahead


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The history deletes what is too old immediately, and with each write."""
    for name in ("COMMIT_S", "PRUNE_S", "SETTLE_S"):
        monkeypatch.setattr(f"phm.gcs.web.history.store.{name}", 0.0 if name != "COMMIT_S" else 0.01)


def write(store: HistoryStore, who: str, at: float) -> None:
    """Write a line, and wait until what is too old then is deleted: that is done before the next line is written."""
    for name in (who, f"{who} again"):
        store.put(line(at, name))
        assert store.flush(120)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("step_s", [31 * DAY_S, -31 * DAY_S, 20_000 * DAY_S])
def test_a_clock_that_is_set_deletes_nothing_of_this_run(tmp_path: Path, step_s: float) -> None:
    """A computer without a battery-backed clock gets the time by network during the flight; a wrong time may come as well."""
    path, clock = tmp_path / "history.db", SteppedClock()
    store = HistoryStore(path, clock)
    store.start()
    write(store, "A01", clock.utc())
    clock.ahead = step_s
    write(store, "A02", clock.utc())
    clock.ahead = 0.0
    write(store, "A03", clock.utc())
    store.close()
    assert [count(path, who) for who in ("A01", "A02", "A03")] == [1, 1, 1]


def test_what_is_too_old_goes_once_the_clock_had_time_to_be_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, impatient: None
) -> None:
    """At the start it may be wrong, until a network is there."""
    monkeypatch.setattr("phm.gcs.web.history.store.SETTLE_S", 3600.0)
    path, clock = tmp_path / "history.db", SteppedClock()
    store = HistoryStore(path, clock)
    store.start()
    write(store, "A01", clock.utc() - 31 * DAY_S)
    write(store, "A02", clock.utc() - 29 * DAY_S)
    assert count(path, "A01") == 1
    monkeypatch.setattr("phm.gcs.web.history.store.SETTLE_S", 0.0)
    write(store, "A03", clock.utc())
    store.close()
    assert [count(path, who) for who in ("A01", "A02", "A03")] == [0, 1, 1]


@pytest.mark.usefixtures("impatient")
def test_what_a_clock_that_was_ahead_has_stamped_goes_first_without_room(tmp_path: Path) -> None:
    """It does not stay for years at the cost of what is newer."""
    path, clock = tmp_path / "history.db", SystemClock()
    store, now = HistoryStore(path, clock, max_bytes=LIMIT), clock.utc()
    store.start()
    for number in range(100):
        store.put(line(now + 4000 * DAY_S + number, "A09"))
    assert store.flush(120)
    for number in range(2000):
        store.put(line(now - 20 * DAY_S + number, "A01"))
    until(lambda: store.flush(0.1) and size(path) <= LIMIT, "the limit", lambda: size(path))
    store.close()
    assert count(path, "A09") == 0 and count(path, "A01") > 1500
