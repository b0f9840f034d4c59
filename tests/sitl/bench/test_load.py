"""How late heartbeats are, and the definition of a load."""

from __future__ import annotations

import pytest

from sitl.bench.load import FAULTS, HALF, HEARTBEAT_S, LOADS, Measured, late_s, table_cells
from sitl.bench.starvation_rows import Row
from sitl.faults import all_faults


@pytest.mark.parametrize(
    ("times", "since", "until", "expected"),
    [
        ([0.0, 2.0, 4.0, 6.0], 1.0, 7.0, 0.0),  # each in time
        ([0.0, 2.0, 5.0, 7.0], 1.0, 8.0, 1.0),  # one arrived a second late
        ([0.0, 9.0, 11.0], 9.5, 12.0, 0.0),  # earlier lateness does not count
        ([0.0, 2.0], 1.0, 9.0, 5.0),  # the next one never arrived
        ([0.0, 2.0, 30.0], 1.0, 3.0, 0.0),  # later ones do not count
        ([], 1.0, 9.0, None),
    ],
)
def test_lateness_is_the_excess_of_the_longest_gap(
    times: list[float], since: float, until: float, expected: float | None
) -> None:
    """The longest gap that overlaps the time of interest, minus the period of 2 s."""
    assert HEARTBEAT_S == 2.0
    assert late_s(times, since, until) == expected


def test_the_loads_and_faults_exist() -> None:
    """Quiet first; every fault is one that PHM recovers."""
    assert next(iter(LOADS)) == "quiet"
    assert [number for name, number in LOADS.items() if name not in ("quiet", HALF)] == [1, 2, 4]
    assert all(all_faults()[name].healable for name in FAULTS)


def test_a_table_row_has_dashes_for_missing_values() -> None:
    """A value that was not measured is a dash."""
    row = Row("node_killed", "node killed", ["nodes/a"], healable=True, alarms=["nodes/a node_missing"], detected_s=0.5)
    row.actions, row.recovered_s = ["restart"], 4.0
    line = table_cells(Measured("quiet", row, None))
    assert line == ("quiet", "node killed", "0.5 s", "1: nodes/a", "restart, recovered after 4.0 s", "-")
