"""The documented names are those of the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.gcs import metrics_catalog as ground
from phm.reporters import metrics_catalog as agent
from phm.wire.metrics_page import LEFT_OUT, Metric

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "metrics.md"


@pytest.mark.parametrize(("where", "metrics"), [("agent", agent.ALL), ("ground", ground.ALL)])
def test_the_table_of_the_reference_is_the_catalogue(where: str, metrics: list[Metric]) -> None:
    """Name, type, labels and meaning, in the same order."""
    table = PAGE.read_text().partition(f"<!-- {where}: begin")[2].partition(f"<!-- {where}: end")[0]
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    expected = [
        f"| `{one.name}` | {one.kind} | {', '.join(f'`{label}`' for label in one.labels)} | {one.help} |"
        for one in (*metrics, LEFT_OUT)
    ]
    assert rows == expected


def test_no_name_is_used_twice() -> None:
    """One Prometheus may scrape agents and ground."""
    names = [one.name for one in (*agent.ALL, *ground.ALL)]
    assert len(set(names)) == len(names)
    assert all(one.name.endswith("_total") == (one.kind == "counter") for one in (*agent.ALL, *ground.ALL))
