"""The saved state of PHM: written completely or not at all, accepted only when valid, with times on the current clocks."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.model import Evidence, Fault, Layer, Level, Result, Slot, Stamp
from phm.recovery.base import LoweredWeight
from phm.recovery.fault_cases import AttemptRecord, PersistedCase, UnfinishedAction
from phm.recovery.ownership import Generation, StartedBy
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_codec import VERSION, InvalidState, convert_time, decode, encode
from phm.recovery.persistence.state_file import KEPT_CORRUPT, MAX_BYTES, StateFile
from phm.recovery.safety.armed_state import LastArmedState
from tests.recovery.simulated_agent import Agent, Containers, Of

BOOT, OTHER = "boot-a", "boot-b"
WINDOW_S = 600.0


def fault(name: str = "ab12-1", opened: Stamp | None = None) -> Fault:
    known = Evidence(never_ok=True, patient=True, file="/a", listed=2, subjects=("A03",))
    result = Result(Level.ERROR, "app has exited", "app exited", "exited", "app", evidence=known)
    when = opened or Stamp(1000.0, 90.0)
    return Fault(
        name,
        "container/app",
        Slot.CONTAINER,
        Layer.DOCKER,
        result,
        when,
        blocks=("files/app",),
        ok_s=61.5,
        ok_since_start_s=90.5,
        ok_in_run_before_s=60.5,
        start_seen=True,
        pause_s=4.5,
    )


def attempt(at: float = 95.0) -> AttemptRecord:
    return AttemptRecord(at, "container/app", "exited", "start", worked=False)


FULL = PersistedState(
    (fault(),),
    (fault("ab12-2"),),
    RecoveryState(
        {"app": (replace(attempt(90.0), backoff_reset=True, not_counted=True), attempt())},
        {"ab12-1": PersistedCase(("advised start",), "start", "restart")},
        {"app": UnfinishedAction("ab12-1", replace(attempt(99.0), took_s=1.5), returned=True)},
        {
            "app": Generation("id2", "2026-01-01T00:00:00Z", 97.0, 92.0, StartedBy.PHM, "app"),
            "side": Generation("id1", "t"),
        },
        LastArmedState(True, 91.0, contradicted=True),
        {"app": "app", "side": "app"},
        lowered=(LoweredWeight("other", "id3", 1024, "pressure/app", 100),),
    ),
    ((900.0, 20.0), (910.0, 60.0)),
    7,
)


def through_json(state: PersistedState, now: Stamp) -> Any:
    return json.loads(json.dumps(encode(state, BOOT, now)))


def test_the_state_is_restored_unchanged_on_the_same_boot() -> None:
    """The monotonic clock continues, so no time changes."""
    document = through_json(FULL, Stamp(1010.0, 100.0))
    assert decode(document, BOOT, Stamp(5.0, 130.0), WINDOW_S) == FULL


def test_a_document_of_an_earlier_version_has_no_count_of_faults() -> None:
    """It is read all the same."""
    document = through_json(FULL, Stamp(1010.0, 100.0))
    del document["fault_count"]
    assert decode(document, BOOT, Stamp(5.0, 130.0), WINDOW_S) == replace(FULL, fault_count=0)


def test_on_another_boot_times_are_converted_through_utc() -> None:
    """An attempt 5 s before the writing is 65 s old a minute later, whatever the new monotonic clock shows."""
    document = through_json(FULL, Stamp(1010.0, 100.0))
    state = decode(document, OTHER, Stamp(1070.0, 20.0), WINDOW_S)
    assert state.clock == ()  # how the clock was set on another boot does not matter on this one
    assert state.recovery.attempts["app"][-1].at == pytest.approx(20.0 - 65.0)
    life = state.recovery.generations["app"]
    assert [life.since, life.made] == pytest.approx([20.0 - 63.0, 20.0 - 68.0])
    assert state.recovery.under_way["app"].attempt.at == pytest.approx(20.0 - 61.0)
    assert state.faults[0].opened == Stamp(1000.0, 20.0 - 70.0)


@pytest.mark.parametrize("boot", ["", OTHER])
@pytest.mark.parametrize(("utc", "age_s"), [(0.0, 0.0), (1e9, WINDOW_S)])
def test_a_clock_that_was_set_gives_no_impossible_age(boot: str, utc: float, age_s: float) -> None:
    """Never negative, and at most the window; an unknown boot is another boot."""
    document = through_json(FULL, Stamp(1010.0, 100.0))
    state = decode(document, boot, Stamp(utc, 20.0), WINDOW_S)
    assert state.recovery.attempts["app"][0].at == pytest.approx(20.0 - age_s)


def test_a_future_time_becomes_the_present() -> None:
    """Also on the same boot: a file may be older than its time says, but never from the future."""
    assert convert_time(Stamp(0.0, 500.0), Stamp(0.0, 100.0), same_boot=True, most_s=60.0).mono == 100.0


def test_the_size_of_the_state_is_limited() -> None:
    """Many faults, targets, attempts and long texts stay far below the reader's limit."""
    long = Result(Level.ERROR, "x" * 100_000, "y" * 100_000, "c", "app")
    faults = tuple(Fault(f"f{n}", f"u{n}", Slot.HOST, Layer.COMPANION, long, Stamp(0, 0)) for n in range(1000))
    attempts = {f"t{n}": tuple(attempt(float(m)) for m in range(300)) for n in range(300)}
    generations = {f"t{n}": Generation("i" * 100_000, "s" * 100_000) for n in range(300)}
    data = json.dumps(
        encode(PersistedState(faults, (), RecoveryState(attempts, generations=generations)), BOOT, Stamp(0, 0))
    )
    assert len(data) < MAX_BYTES
    state = decode(json.loads(data), BOOT, Stamp(0, 0), WINDOW_S)
    assert (len(state.faults), len(state.recovery.attempts), len(state.recovery.attempts["t299"])) == (256, 64, 100)


def spoil(key: str, value: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda document: {**document, key: value}


@pytest.mark.parametrize(
    "change",
    [
        lambda document: [document],
        spoil("v", VERSION - 1),
        spoil("v", VERSION + 1),
        spoil("v", None),
        spoil("faults", 3),
        spoil("faults", [{}]),
        spoil("faults", [{"opened": {"utc": "nan", "mono": 0}}]),
        spoil("attempts", []),
        spoil("attempts", {"app": [{"at": {"utc": 1e300, "mono": 0}}]}),
        spoil("cases", {"x": 1}),
        spoil("under_way", {"app": {"fault": "x"}}),
        spoil("armed", {"armed": True}),
        spoil("armed", []),
        spoil("generations", {"app": {"id": "x", "started": "y", "by": "phm", "phm_for": "app", "made": None}}),
        spoil(
            "generations", {"app": {"id": "x", "started": "y", "by": "z", "phm_for": "", "since": None, "made": None}}
        ),
        lambda document: {key: value for key, value in document.items() if key != "boot"},
    ],
)
def test_an_invalid_document_is_rejected(change: Callable[[dict[str, Any]], Any]) -> None:
    """A wrong version or a wrong value anywhere makes the document invalid; no other exception is raised."""
    document = through_json(FULL, Stamp(1010.0, 100.0))
    with pytest.raises(InvalidState):
        decode(change(document), BOOT, Stamp(1010.0, 100.0), WINDOW_S)


# ---------------------------------------------------------------- on disk


def test_the_state_file_is_private_and_complete(tmp_path: Path) -> None:
    """The directory is created, the file is 0600, no temporary file remains, and a leftover of a power cut does not
    matter.
    """
    file = StateFile(str(tmp_path / "a" / "b"), testing.FakeClock(), BOOT)
    assert file.load(WINDOW_S) == (PersistedState(), "")
    file.save(PersistedState())
    (file.path.parent / "state.json.tmp").write_text("torn")
    file.save(FULL)
    assert [entry.name for entry in file.path.parent.iterdir()] == ["state.json"]
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600
    state, warning = file.load(WINDOW_S)
    assert (warning, [each.id for each in state.faults]) == ("", ["ab12-1"])


@pytest.mark.parametrize("data", [b"", b"\x00" * 512, b'{"v": 1, "fau', b"[" * 100_000, b" " * (MAX_BYTES + 1), b"{}"])
def test_an_invalid_file_is_renamed_with_a_warning(tmp_path: Path, data: bytes) -> None:
    """PHM starts with an empty state, reports it, and keeps the file for inspection."""
    file = StateFile(str(tmp_path), testing.FakeClock(), BOOT)
    file.path.write_bytes(data)
    state, warning = file.load(WINDOW_S)
    assert state == PersistedState()
    assert "renamed to state.json.corrupt-" in warning
    assert not file.path.exists()
    assert next(tmp_path.glob("state.json.corrupt-*")).read_bytes() == data


def test_three_invalid_files_are_kept(tmp_path: Path) -> None:
    """The newest three: a disk that corrupts files must not be filled with them."""
    clock = testing.FakeClock()
    file = StateFile(str(tmp_path), clock, BOOT)
    for number in range(6):
        file.path.write_text(f"broken {number}")
        file.load(WINDOW_S)
        clock.advance(60.0)
    texts = sorted(entry.read_text() for entry in tmp_path.glob("state.json.corrupt-*"))
    assert texts == [f"broken {number}" for number in range(6)][-KEPT_CORRUPT:]


def test_an_operators_copy_of_an_invalid_file_is_kept(tmp_path: Path) -> None:
    """Only names that PHM creates are removed; a directory of such a name is not an error."""
    clock = testing.FakeClock()
    file = StateFile(str(tmp_path), clock, BOOT)
    (tmp_path / "state.json.corrupt-0-flight-7").write_text("theirs")
    (tmp_path / "state.json.corrupt-19990101T000000Z").mkdir()
    for number in range(5):
        file.path.write_text(f"broken {number}")
        assert "renamed to" in file.load(WINDOW_S)[1]
        clock.advance(60.0)
    assert (tmp_path / "state.json.corrupt-0-flight-7").read_text() == "theirs"
    kept = [entry for entry in tmp_path.glob("state.json.corrupt-2*") if entry.is_file()]
    assert len(kept) == KEPT_CORRUPT


def test_an_unreadable_state_is_reported(tmp_path: Path) -> None:
    """A directory in place of the file: reported, and PHM starts with an empty state."""
    file = StateFile(str(tmp_path), testing.FakeClock(), BOOT)
    file.path.mkdir()
    state, warning = file.load(WINDOW_S)
    assert state == PersistedState()
    assert "cannot read" in warning


@pytest.mark.parametrize(("step_s", "known_since"), [(0.0, 500.0), (7200.0, None)])
def test_clock_adjustments_are_known_over_a_restart(tmp_path: Path, step_s: float, known_since: float | None) -> None:
    """Unless it was set while no PHM was running: then their number is unknown."""
    clocks = [testing.FakeClock(mono=500.0)]
    for begin in range(2):
        if begin:
            clocks.append(testing.FakeClock(clocks[0].mono() + 5.0, clocks[0].utc() + 5.0 + step_s))
        phm = Agent({"container/app": Of("app")}, Containers("app"), clocks[begin], folder=tmp_path)
        later = clocks[begin].mono()
        phm.rest(30.0)
        phm.stop()
    assert clocks[1].steps.known_since() == (known_since or later)
