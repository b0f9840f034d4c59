"""The names in the history's file, and the senders of which it has samples: those of a flood make room for new ones."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Stamp
from phm.gcs.frames import ComputerStatus, Frame, Heartbeat
from phm.gcs.station import Received
from phm.gcs.web.history import collector
from phm.gcs.web.history.collector import Collector
from phm.gcs.web.history.faults import FaultList
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.store import FEW, HistoryRow, HistorySample, HistoryStore
from tests.fakes.until import until
from tests.gcs.bench import phm_heartbeat

DAY_S = 86_400.0
STORE = "phm.gcs.web.history.store"


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> HistoryStore:
    """With room for three series; it deletes what is too old without waiting."""
    monkeypatch.setattr(f"{STORE}.MAX_SERIES", 3)
    monkeypatch.setattr(f"{STORE}.PRUNE_S", 0.0)
    monkeypatch.setattr(f"{STORE}.SETTLE_S", 0.0)
    monkeypatch.setattr(f"{STORE}.COMMIT_S", 0.01)
    return HistoryStore(tmp_path / "history.db", SystemClock())


def kinds(store: HistoryStore, who: str) -> list[str]:
    return [one["kind"] for one in HistoryReader(store.path).kinds(who)]


def names(store: HistoryStore) -> list[str]:
    with sqlite3.connect(store.path) as connection:
        return sorted(who for (who,) in connection.execute("SELECT who FROM series"))


def test_names_whose_samples_are_too_old_make_room(store: HistoryStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """A flood of invented names must not end the plots of new agents for good; what is left out until then is said."""
    monkeypatch.setattr(f"{STORE}.FEW", 0)
    monkeypatch.setattr(store, "_max_age_s", math.inf)
    now = SystemClock().utc()
    store.start()
    for number in range(3):
        store.put(HistorySample(f"A25{number}", "cpu", now - 31 * DAY_S, 1.0))
    store.put(HistorySample("A07", "cpu", now, 1.0))
    assert store.flush(120) and kinds(store, "A07") == []
    assert store.problem() == "1 samples are left out: the history has too many series"
    monkeypatch.setattr(store, "_max_age_s", 30 * DAY_S)

    def kept() -> bool:
        store.put(HistorySample("A07", "cpu", now, 1.0))
        return store.flush(120) and kinds(store, "A07") == ["cpu"]

    until(kept, "the sample of the new name")
    assert names(store) == ["A07"]
    until(lambda: not store.problem(), "the end of the problem")
    store.close()


def test_without_room_invented_names_end_first(store: HistoryStore) -> None:
    """They have few samples; a series with more of them stays, and one whose samples are new."""
    now = SystemClock().utc()
    store.start()
    for number in range(FEW):
        store.put(HistorySample("A07", "cpu", now - DAY_S + number, 1.0))
    store.put(HistorySample("A250", "cpu", now - DAY_S, 1.0))
    store.put(HistorySample("A251", "cpu", now, 1.0))

    def kept() -> bool:
        store.put(HistorySample("A08", "cpu", now, 1.0))
        return store.flush(120) and kinds(store, "A08") == ["cpu"]

    until(kept, "the sample of the new name")
    assert names(store) == ["A07", "A08", "A251"]
    store.close()


class Kept:
    """A history that only remembers the samples."""

    def __init__(self) -> None:
        self.samples: list[tuple[str, str]] = []

    def put(self, row: HistorySample | HistoryRow) -> None:
        assert isinstance(row, HistorySample)
        self.samples.append((row.who, row.kind))


def test_samples_of_new_agents_are_taken_after_a_flood(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new agent takes the place of the one that was silent for the longest time."""
    monkeypatch.setattr(collector, "MAX_SENDERS", 2)
    store = Kept()
    made = Collector(store, FaultList())  # type: ignore[arg-type]

    def receive(at: float, *frames: Frame) -> None:
        for frame in frames:
            made.frame(Received(frame, b"", "udp", Stamp(1e9 + at, at), isinstance(frame, Heartbeat)))

    receive(0.0, phm_heartbeat(1), phm_heartbeat(250))
    receive(1.0, phm_heartbeat(1), phm_heartbeat(7))
    store.samples.clear()
    load = [ComputerStatus(number, 193, 40, None, None) for number in (1, 7, 250)]
    receive(2.0, *load)
    assert store.samples == [("A01", "cpu"), ("A07", "cpu")]
    store.samples.clear()
    receive(20.0, phm_heartbeat(1))
    assert sorted(store.samples) == [("A01", "gap"), ("A01", "level"), ("A01", "rate"), ("A07", "rate")]
