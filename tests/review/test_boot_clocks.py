"""Runs that nothing else places follow the autopilot's time since boot."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from tests.fakes.recorded_flight import FOLDER
from tests.review.records import T0, Flown, report

BY = "the autopilot's time since boot, as in another run"
RECORDED = FOLDER / "streams_phm.jsonl.gz"
"""The autopilot's time since boot is in its lines at 3395.6 to 3399.2 (113.4 to 117 s), and after a reboot at 3400.7 (2.5 s)."""

BEHIND_S = (40.0, 1_795_306_000.0)
"""By how much the clock after the restart is wrong: the second is in 1970."""


def run(folder: Path, number: int, start: float, *, booted: float, wrong_s: float = 0.0, machine: str = "") -> None:
    """200 s of PHM after a start of the computer, with an autopilot that booted then. Times are true seconds since T0."""
    made = Flown(
        folder / str(number),
        boot=f"boot000{number}",
        start=start,
        wrong_s=wrong_s,
        mono=20.0 - start,
        machine_boot=machine,
    )
    made.autopilot(booted)
    made.until(start + 200.0)
    made.fail("nodes/node_1", lasts=1.0)
    made.until(start + 220.0)
    made.close()


def found(folder: Path) -> tuple[list[dict[str, Any]], list[float]]:
    """The clocks of the runs, by the ids of these, and when the faults opened, in seconds since T0."""
    made = report(folder)
    return sorted(made["clocks"]["runs"], key=lambda one: str(one["boot_id"])), [
        fault["opened"] - T0 for fault in made["faults"]
    ]


@pytest.mark.parametrize("behind_s", [200.0, 35.0])
def test_a_clock_that_was_set_back_by_a_restart_is_corrected(tmp_path: Path, behind_s: float) -> None:
    """The computer restarts with the time at which it last saved it; the autopilot went on."""
    run(tmp_path, 1, 0.0, booted=-50.0)
    run(tmp_path, 2, 250.0, booted=-50.0, wrong_s=-behind_s)
    (first, second), opened = found(tmp_path)
    assert (second["applied"], second["by"], second["votes"]) == (True, BY, 10)
    assert second["offset_s"] == pytest.approx(behind_s, abs=0.2) and second["error_s"] == pytest.approx(1.0, abs=0.2)
    assert opened == [pytest.approx(200.0), pytest.approx(450.0, abs=0.2)]
    assert first["offset_s"] is None


def test_an_autopilot_that_has_rebooted_moves_nothing(tmp_path: Path) -> None:
    """Its time since boot is shorter than at the end of the run before, so the pause is unknown."""
    run(tmp_path, 1, 0.0, booted=-5.0)
    run(tmp_path, 2, 250.0, booted=225.0, wrong_s=-245.0)
    (_, second), _ = found(tmp_path)
    assert (second["offset_s"], second["applied"], second["by"]) == (None, False, "")


def test_an_autopilot_that_rebooted_long_ago_does_not_move_a_later_day_back(tmp_path: Path) -> None:
    """On the second day it has been running longer than at the end of the first one. Both clocks are right."""
    run(tmp_path, 1, 0.0, booted=-50.0)
    run(tmp_path, 2, 86_400.0, booted=86_000.0)
    (_, second), opened = found(tmp_path)
    assert second["offset_s"] is None and opened == [200.0, 86_600.0]


def test_right_clocks_are_left_alone(tmp_path: Path) -> None:
    """The autopilot agrees within the error."""
    run(tmp_path, 1, 0.0, booted=-50.0)
    run(tmp_path, 2, 250.0, booted=-50.0, wrong_s=-0.5)
    assert found(tmp_path)[0][1]["offset_s"] is None


@pytest.mark.parametrize("place", [1, 2])
def test_a_run_whose_clock_was_never_set_finds_its_place(tmp_path: Path, place: int) -> None:
    """In 1970 by its own clock, it is before all others; by the autopilot it is before or after the other run."""
    for number, start in ((1, 0.0), (2, 250.0)):
        run(tmp_path, number, start, booted=-50.0, wrong_s=30.0 - T0 - start if number == place else 0.0)
    clocks, opened = found(tmp_path)
    assert clocks[place - 1]["applied"] and opened == [pytest.approx(200.0, abs=0.2), pytest.approx(450.0, abs=0.2)]


def test_a_run_that_fits_two_days_stays_where_it_is(tmp_path: Path) -> None:
    """The autopilot has been running longer than at the end of the runs of both days."""
    run(tmp_path, 1, 0.0, booted=-50.0)
    run(tmp_path, 2, 86_400.0, booted=86_350.0)
    run(tmp_path, 3, 90_000.0, booted=86_350.0, wrong_s=30.0 - T0 - 90_000.0)
    assert found(tmp_path)[0][2]["offset_s"] is None


def test_a_run_is_not_moved_onto_another_one(tmp_path: Path) -> None:
    """A third run of this agent is there, and its own clock says so."""
    run(tmp_path, 1, 0.0, booted=-50.0)
    run(tmp_path, 2, 250.0, booted=-50.0, wrong_s=-200.0)
    run(tmp_path, 3, 300.0, booted=290.0)
    assert found(tmp_path)[0][1]["offset_s"] is None


def test_runs_of_one_start_of_the_machine_have_one_clock_already(tmp_path: Path) -> None:
    """Nothing is to be derived from the autopilot: the monotonic clock went on."""
    for number, start in ((1, 0.0), (2, 250.0)):
        run(tmp_path, number, start, booted=-50.0, wrong_s=-100.0 * number, machine="machine1")
    assert [clock["offset_s"] for clock in found(tmp_path)[0]] == [None, None]


def split(folder: Path, at: float, *, behind_s: float) -> None:
    """The recorded log as two runs; the computer has restarted in between, so the second has other clocks and counts reboots from 0."""
    lines = [json.loads(line) for line in gzip.decompress(RECORDED.read_bytes()).splitlines()]
    later = [line for line in lines if line["mono"] >= at]
    counted = min(line["values"]["reboots"] for line in later if line.get("unit") == "autopilot")
    for line in later:
        line.update(boot_id="another", mono=line["mono"] - 3000.0, utc_s=line["utc_s"] - behind_s)
        if line.get("unit") == "autopilot":
            line["values"]["reboots"] -= counted
    folder.mkdir()
    for name, of_run in (("1", [line for line in lines if line["mono"] >= 3000.0]), ("2", later)):
        (folder / f"{name}.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in of_run), "utf-8")


@pytest.mark.parametrize("behind_s", BEHIND_S)
def test_a_recorded_autopilot_places_the_run_after_a_restart(tmp_path: Path, behind_s: float) -> None:
    """A real ArduPilot's time since boot, once before and twice after the pause."""
    split(tmp_path / "log", 3396.0, behind_s=behind_s)
    first, second = sorted(report(tmp_path / "log")["clocks"]["runs"], key=lambda one: -len(one["boot_id"]))
    assert (second["boot_id"], second["by"], second["applied"]) == ("another", BY, True)
    assert second["offset_s"] == pytest.approx(behind_s, abs=0.2)
    assert first["offset_s"] is None


@pytest.mark.parametrize("behind_s", BEHIND_S)
def test_a_recorded_reboot_ends_what_the_autopilot_says(tmp_path: Path, behind_s: float) -> None:
    """The same log, with the restart of the computer after the reboot of the autopilot."""
    split(tmp_path / "log", 3399.9, behind_s=behind_s)
    assert [run["offset_s"] for run in report(tmp_path / "log")["clocks"]["runs"]] == [None, None]
