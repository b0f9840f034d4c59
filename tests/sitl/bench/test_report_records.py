"""The records of the report's bench: what the report finds in them, and what is left of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from phm.wire import json_log
from sitl.bench import report, report_outputs, report_records
from tests.review import records

SIZE, AGENTS = 3_000_000, 2


@pytest.fixture(scope="module")
def made() -> list[report_records.Line]:
    return report_records.pattern(1800.0)


@pytest.mark.parametrize("compressed", [True, False])
def test_generated_records_are_those_of_real_agents(
    tmp_path: Path, made: list[report_records.Line], compressed: bool
) -> None:
    """Several runs of each agent, rotated files in order, numbers without a gap, faults, flights, and nothing that cannot be read."""
    report_records.write(tmp_path, SIZE, AGENTS, compressed=compressed, made=made)
    assert len(list(tmp_path.rglob("*.gz"))) == (AGENTS * 3 if compressed else 0)
    lines = list(json_log.read(tmp_path / "agent_1"))
    assert sum(len(str(line)) for line in lines) > SIZE / AGENTS / 2
    runs = list(dict.fromkeys(line["boot_id"] for line in lines))
    assert len(runs) > 1
    for run in runs:
        numbers = [line["seq"] for line in lines if line["boot_id"] == run]
        assert numbers == list(range(1, len(numbers) + 1))
    found = records.report(tmp_path)
    assert [agent["agent"] for agent in found["agents"]] == ["agent_1", "agent_2"]
    assert [agent["missing_lines"] for agent in found["agents"]] == [0, 0]
    assert found["files"]["problems"] == [] and found["flights"]
    faults = [fault for fault in found["faults"] if fault["outcome"] == "resolved"]
    assert len(faults) > len(runs) and {fault["by"] for fault in faults} == {"restart"}


def test_a_measurement_leaves_nothing_behind(tmp_path: Path, made: list[report_records.Line]) -> None:
    """And its table has the figures of the size."""
    row = report.measure("compressed", 1_000_000, AGENTS, made, tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert row.lines > 1000 and row.disk_bytes < row.text_bytes and row.time_s > 0 and row.memory_bytes > 1_000_000
    assert report.markdown([row]).splitlines()[-1].startswith("| 0.001 GB, compressed | ")


def test_a_dataset_of_flights_has_each_of_them_once(tmp_path: Path, made: list[report_records.Line]) -> None:
    """Flights of several agents, more than are added together; nothing is left of them."""
    row = report_outputs.dataset(11, made, tmp_path, batch=10)
    assert list(tmp_path.iterdir()) == []
    assert row.flights == 11 and row.faults == 11 * 3 and row.files > 11 * 3 and row.query_s > 0 and row.write_s > 0
    assert row.disk_bytes < row.text_bytes and report_outputs.text(row).startswith("11 flights of 30 min (")


def test_a_page_of_many_agents_is_measured_as_a_user_makes_it(tmp_path: Path, made: list[report_records.Line]) -> None:
    """Its bytes, and the time until a browser shows it; without a browser that is not known."""
    seen: list[str] = []

    def observe(file: Path) -> list[float]:
        seen.append(file.read_text("utf-8"))
        return [3.0, 1.0, 2.0]

    row = report_outputs.page(2, made, tmp_path, observe)
    assert list(tmp_path.iterdir()) == []
    assert all(f'"agent":"agent_{number}"' in seen[0] for number in (1, 2))
    assert (row.agents, row.page_bytes, row.open_s) == (2, len(seen[0].encode()), 2.0)
    assert report_outputs.text(row).endswith("drawn in Chromium after 2.00 s")
    assert report_outputs.text(replace(row, open_s=None)).endswith("no Chromium to open it")


@pytest.mark.browser
def test_a_page_is_opened_in_a_real_browser(tmp_path: Path, made: list[report_records.Line]) -> None:
    """Each time until it is drawn."""
    row = report_outputs.page(2, made, tmp_path)
    assert row.open_s is not None and row.open_s > 0


@pytest.mark.parametrize("words", [["--flights", "-1"], ["--page", "1000000"]])
def test_an_impossible_number_is_an_error(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """It says what is allowed."""
    with pytest.raises(SystemExit):
        report.main(words)
    assert "--flights and --page are from 1 to 100000" in capsys.readouterr().err
