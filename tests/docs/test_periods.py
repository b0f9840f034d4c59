"""The default periods that texts for users state are those of `phm.transport.priority`."""

from __future__ import annotations

from pathlib import Path

from phm.transport.priority import SIZES

ROOT = Path(__file__).parents[2]


def _stated(column: int) -> str:
    """The default of a period in `phm.yaml`, by the table."""
    (first, *more), last = SIZES[:-1], SIZES[-1]
    periods = [f"{first[column]:g}s for up to {first[0]}", *(f"{size[column]:g}s for {size[0]}" for size in more)]
    return f"(by the number of agents: {', '.join(periods)}, {last[column]:g}s for more)"


def test_the_configuration_states_the_default_periods() -> None:
    """In the order of the file: heartbeats, refreshes."""
    text = (ROOT / "config" / "phm.yaml").read_text(encoding="utf-8")
    stated = [line.partition("`null` ")[2] for line in text.splitlines() if "by the number of agents" in line]
    assert stated == [_stated(1), _stated(2)]


def test_the_example_of_a_large_swarm_has_its_period() -> None:
    text = " ".join((ROOT / "docs" / "reference" / "mavlink.md").read_text(encoding="utf-8").split())
    (above, *_), (agents, period_s, _) = SIZES[1:3]
    example = f"heartbeats {period_s:g} s apart ({above + 1} to {agents} agents) that is {2.5 * period_s:g} s"
    assert example in text
