"""The records of the report's bench: what the report finds in them, and what is left of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.wire import json_log
from sitl.bench import report, report_records
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
