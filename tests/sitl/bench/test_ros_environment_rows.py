"""The rows of `sitl.bench.ros_environments` and their table."""

from __future__ import annotations

from pathlib import Path

from sitl.bench.ros_environment_rows import DISCOVERIES, Case, Row, as_json, cases, from_json, markdown
from sitl.bench.ros_environments import write

CASE = Case("host", "local", "shipped", "jazzy")
SEEN = Row(CASE, 3, 3, 3, 4.2, 1.4, "nodes/a/node_1")


def test_all_cases_are_measured_once_and_may_be_chosen_by_name() -> None:
    """Two networks, two profiles and two distributions for each way of discovery."""
    every = list(cases())
    assert len(every) == len(set(every)) == 8 * len(DISCOVERIES)
    assert list(cases(["host/local/shipped/jazzy"])) == [CASE]


def test_a_cell_says_what_was_seen() -> None:
    """Nodes, data, and the time until the killed node was reported."""
    assert SEEN.cell == "yes, 1.4 s"
    assert Row(CASE, of=3).cell == "**no**"
    assert Row(CASE, 3, 0, 3, killed_s=1.0).cell == "yes, data of 0, 1.0 s"
    assert Row(CASE, 1, 1, 3).cell == "1 of 3 nodes, data of 1"
    assert Row(CASE, 3, 3, 3).cell == "yes, killed node not reported"


def test_rows_survive_their_file(tmp_path: Path) -> None:
    """The table is written from files, also of several runs."""
    file = tmp_path / "rows.json"
    file.write_text(as_json([SEEN], "a machine"), "utf-8")
    assert from_json(file) == ("a machine", [SEEN])


def test_the_table_has_a_line_for_each_network_and_discovery(tmp_path: Path) -> None:
    """And a column for each distribution and profile; text around the markers stays."""
    table = markdown([SEEN, Row(Case("bridge", "default", "none", "kilted"), 3, 3, 3, 9.0, 3.4)])
    assert [line.count("|") for line in table.splitlines()] == [7] * 4
    assert table.splitlines()[3] == "| host network | `LOCALHOST`, separate IPC |  | yes, 1.4 s |  |  |"
    page, file = tmp_path / "ros.md", tmp_path / "rows.json"
    page.write_text(
        "before\n<!-- environments: begin, written by python -m sitl.bench.ros_environments --markdown -->\nold\n"
        "<!-- environments: end -->\nafter\n"
    )
    file.write_text(as_json([SEEN], "a machine"), "utf-8")
    write([file], page)
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("-->\nafter\n")
    assert "yes, 1.4 s" in text and "old" not in text
