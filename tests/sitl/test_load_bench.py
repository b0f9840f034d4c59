"""How late heartbeats are, and what a load is."""

from __future__ import annotations

import pytest

from sitl.bench.load import FAULTS, HALF, HEARTBEAT_S, LOADS, Measured, late_s, table_cells
from sitl.bench.starvation_rows import Row
from sitl.faults import all_faults


@pytest.mark.parametrize(
    ("times", "since", "until", "expected"),
    [
        ([0.0, 2.0, 4.0, 6.0], 1.0, 7.0, 0.0),  # each in time
        ([0.0, 2.0, 5.0, 7.0], 1.0, 8.0, 1.0),  # one came a second late
        ([0.0, 9.0, 11.0], 9.5, 12.0, 0.0),  # what was late before does not count
        ([0.0, 2.0], 1.0, 9.0, 5.0),  # the next has not come at all
        ([0.0, 2.0, 30.0], 1.0, 3.0, 0.0),  # later ones do not count
        ([], 1.0, 9.0, None),
    ],
)
def test_lateness(times: list[float], since: float, until: float, expected: float | None) -> None:
    """The longest gap that touches the time of interest, less the period of 2 s."""
    assert HEARTBEAT_S == 2.0
    assert late_s(times, since, until) == expected


def test_the_loads_and_faults_exist() -> None:
    """Quiet first; every fault is one that PHM heals."""
    assert next(iter(LOADS)) == "quiet"
    assert [number for name, number in LOADS.items() if name not in ("quiet", HALF)] == [1, 2, 4]
    assert all(all_faults()[name].healable for name in FAULTS)


def test_a_line_of_the_table() -> None:
    """What was not measured is a dash."""
    row = Row("node_killed", "node killed", ["nodes/a"], healable=True, alarms=["nodes/a node_missing"], detected_s=0.5)
    row.actions, row.healed_s = ["restart"], 4.0
    line = table_cells(Measured("quiet", row, None))
    assert line == ("quiet", "node killed", "0.5 s", "1: nodes/a", "restart, healed after 4.0 s", "-")
