"""What is too much for a report is joined or counted: nothing that is left out reads as if nothing had been there."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from phm.review import agent_row, document, levels, page, tables
from phm.review.agent_run import MOST_POINTS, MOST_SERIES, Run
from phm.review.ground_part import RADIO
from phm.review.measurements import GROUPS, PLOTTED
from phm.review.part import Part
from tests.review import raw
from tests.review.records import T0, Ground, report

SECONDS = 6099


def flapping(folder: Path, unit: str = "nodes/node_1") -> Path:
    """OK for a second, ERROR for a second, for an hour and three quarters, with a report every 20 s."""
    names = ("OK", "ERROR")
    changes = [raw.change(at, unit, names[(at + 1) % 2], names[at % 2]) for at in range(SECONDS)]
    return raw.write(folder, [*changes, raw.unit(SECONDS, unit)])


def covered(segments: list[list[Any]]) -> list[list[Any]]:
    """From where to where the segments are without a gap."""
    found: list[list[Any]] = []
    for begin, end, _ in segments:
        if found and begin <= found[-1][1] + 0.02:
            found[-1][1] = end
        else:
            found.append([begin, end])
    return found


def counts(made: dict[str, Any]) -> dict[str, int]:
    return {row["what"]: row["count"] for row in made["cut"]}


def test_a_timeline_of_thousands_of_changes_goes_to_its_end(tmp_path: Path) -> None:
    """Each change of the agent is there; the 6099 of its unit are too many, and are joined with the worst level."""
    (agent,) = report(flapping(tmp_path))["agents"]
    assert covered(agent["levels"]) == [[T0, T0 + SECONDS]]
    assert (len(agent["levels"]), agent["joined_s"]) == (SECONDS, 0.0)
    (unit,) = agent["units"].values()
    assert covered(unit) == [[T0, T0 + SECONDS]]
    assert len(unit) <= agent_row.MOST_SEGMENTS // agent_row.MOST_UNITS and agent["units_joined_s"] > 0.0
    assert agent["error_s"] == pytest.approx(SECONDS // 2)


def test_an_agent_with_more_changes_than_the_timeline_takes_looks_no_better(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neighbours become one ERROR; how close changes must be for that is said, also on the page."""
    monkeypatch.setattr(agent_row, "MOST_SEGMENTS", 1000)
    monkeypatch.setattr(agent_row, "LEAST_SEGMENTS", 1000)
    made = report(flapping(tmp_path))
    (agent,) = made["agents"]
    assert covered(agent["levels"]) == [[T0, T0 + SECONDS]] and len(agent["levels"]) <= 1000
    assert agent["joined_s"] > 2.0 and {level for _, _, level in agent["levels"][:-1]} == {"ERROR"}
    assert agent["error_s"] == pytest.approx(SECONDS // 2)
    assert "drawn as one, with the worst of their levels" in page.render(made)


LENGTH = st.floats(0.01, 100.0)
SEGMENTS = st.lists(st.tuples(LENGTH, st.sampled_from([*levels.RANK, "n/a", ""])), min_size=1, max_size=120)


@settings(max_examples=200, deadline=None)
@given(SEGMENTS, st.integers(1, 60))
def test_joined_segments_cover_the_same_time_and_are_nowhere_better(
    lengths: list[tuple[float, str]], most: int
) -> None:
    """A drawing has at most so many; without a level (PHM did not run) stays so while there is room."""
    rank = [*levels.RANK, "n/a"]
    at, segments = 0.0, list[levels.Segment]()
    for length, level in lengths:
        segments += [(at, at + length, level)] if level else []
        at += length
    kept, joined_s = levels.shortened(segments, most)
    assert len(kept) <= most
    assert (joined_s > 0.0) if len(segments) > most else (kept, joined_s) == (segments, 0.0)
    assert all(one[1] <= two[0] + 1e-6 for one, two in itertools.pairwise(kept))
    for begin, end, level in segments:
        over = [one for one in kept if one[0] <= begin and end <= one[1]]
        assert len(over) == 1 and rank.index(over[0][2]) <= rank.index(level)
    gaps = sum(one[1] + 1e-6 < two[0] for one, two in itertools.pairwise(segments))
    if gaps < most // 4:
        assert sum(end - begin for begin, end, _ in kept) == pytest.approx(sum(b - a for a, b, _ in segments))


def test_units_actions_and_spans_beyond_the_limits_are_counted(tmp_path: Path) -> None:
    """In the document, on the page and in the tables of the terminal."""
    events: list[dict[str, Any]] = []
    for number in range(45):
        name = f"nodes/node_{number:02d}"
        events += [raw.change(0, name, "STALE", "OK"), raw.change(5, name, "OK", "ERROR")]
    action = {"event": "action", "fault": "f1", "unit": "nodes/node_00", "action": "restart", "phase": "started"}
    events += [{**action, "at": 6 + number * 0.01} for number in range(2300)]
    events += [raw.unit(40, "nodes/node_00", "ERROR")]
    made = report(raw.write(tmp_path, events))
    (agent,) = made["agents"]
    assert (len(agent["units"]), len(agent["actions"])) == (40, 2000)
    assert counts(made) == {"units in the timeline": 5, "actions in the timeline": 300}
    shown = {title: rows for title, _, rows in tables.tables(made)}
    assert ("agent_1", "units in the timeline", "5") in shown["Not in this report"]
    text = page.render(made)
    assert "Not in this report" in text and '"units_cut":[["agent_1",5]]' in text


def test_spans_beyond_the_limit_are_the_shortest_and_their_sum_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of many flights the longest are drawn; the table says for how long the autopilot was armed in all of them."""
    monkeypatch.setattr(agent_row, "MOST_SPANS", 2)
    flight = {"event": "flight", "number": 1}
    edges = [(10, True), (20, False), (30, True), (32, False), (40, True), (45, False)]
    events = [raw.unit(0, "nodes/n1"), *({**flight, "began": began, "at": at} for at, began in edges)]
    made = report(raw.write(tmp_path, [*events, raw.unit(50, "nodes/n1")]))
    (agent,) = made["agents"]
    assert agent["armed"] == [[T0 + 10, T0 + 20], [T0 + 40, T0 + 45]]
    assert agent["armed_s"] == 17.0 and counts(made) == {"armed periods": 1}


def test_every_unit_has_its_availability_and_what_was_not_known(tmp_path: Path) -> None:
    """500 topics and 300 of them unknown for a time: all are there, and the tables count what they do not show."""
    events: list[dict[str, Any]] = []
    for number in range(500):
        name = f"topics/t{number:03d}"
        events.append(raw.change(0, name, "STALE", "STALE" if number < 300 else "OK"))
        events += [raw.change(5, name, "STALE", "OK")] if number < 300 else []
    made = report(raw.write(tmp_path, [*events, raw.unit(10, "topics/t000")]))
    assert sum(row["kind"] == "topic" for row in made["availability"]) == 500
    assert len(made["unknown"]) == 300 and counts(made) == {"units in the timeline": 260}
    shown = {title: rows for title, _, rows in tables.tables(made, most=100)}
    assert shown["What was not known"][-1][0] == "and 200 more"


def test_lists_of_a_document_say_what_they_leave_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Units that were not known, of all agents together."""
    monkeypatch.setattr(document, "MOST_UNKNOWN", 3)
    events = [raw.change(0, f"topics/t{number}", "OK", "STALE") for number in range(5)]
    made = report(raw.write(tmp_path, [*events, raw.unit(10, "topics/t0", "STALE")]))
    assert len(made["unknown"]) == 3 and counts(made) == {"units that were not known for a time": 2}
    shown = {title: rows for title, _, rows in tables.tables(made)}
    assert ("all", "units that were not known for a time", "2") in shown["Not in this report"]


def test_each_of_many_topics_has_a_plot(tmp_path: Path) -> None:
    """70 topics; beyond the limit they are counted, and the memory for their points is that of 64."""
    events = [
        raw.unit(at, f"rates/t{number:03d}", hz=float(number)) for at in range(0, 4000, 20) for number in range(70)
    ]
    made = report(raw.write(tmp_path, events))
    assert len(made["plots"]) == 70 and made["cut"] == []
    run = Run("agent_1", 1, "b")
    for number in range(MOST_SERIES + 7):
        for at in range(200):
            series = run.series_of(f"rates/t{number} hz")
            if series is not None:
                series.add(float(at), 1.0)
    assert sum(len(series.points()) for series in run.series.values()) <= MOST_POINTS
    assert (len(run.series), len(run.unplotted)) == (MOST_SERIES, 7)
    last = run.series[f"rates/t{MOST_SERIES - 1} hz"].points()
    assert last[-1][0] > 190.0 and last[0][0] < 10.0


def test_measurements_without_a_plot_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when a record is read in pieces that are merged."""
    monkeypatch.setattr("phm.review.agent_run.MOST_SERIES", 3)
    events = [raw.unit(at, f"rates/t{number}", hz=1.0) for at in (0, 20) for number in range(5)]
    assert counts(report(raw.write(tmp_path, events))) == {"measurements without a plot": 2}
    one, two = Run("a", 1, "b"), Run("a", 1, "b")
    for number in range(4):
        one.series_of(f"t{number}")
        two.series_of(f"t{number + 2}")
    one.merge(two)
    assert sorted(one.series) == ["t0", "t1", "t2"] and one.unplotted == {"t3", "t4", "t5"}


def test_each_measurement_that_is_kept_has_a_plot_with_a_title(tmp_path: Path) -> None:
    """All that the checks of host, radio, links and rates measure over time, and what the ground knows of its radios."""
    radio = dict.fromkeys(("rssi", "remrssi", "noise", "remnoise", "margin", "remmargin", "rxerrors_s"), 5.0)
    link = {"tx_bytes_s": 1.0, "rx_bytes_s": 2.0, "loss_1_1_percent": 3.0}
    host = {"cpu_percent": 1.0, "memory_percent": 2.0, "temperature_c": 3.0, "disk_percent /": 4.0}
    wanted = {**radio, "txbuf_percent": 80.0, **link, **host, "hz": 10.0}
    events = []
    for at in (0, 20):
        events += [raw.unit(at, "radio/gcs", **radio, txbuf_percent=80.0), raw.unit(at, "link/gcs", **link)]
        events += [raw.unit(at, "host/all", **host), raw.unit(at, "rates/t1", hz=10.0, expected_hz=10.0)]
    ground = Ground(tmp_path / "ground.jsonl")
    for at in (0, 60):
        ground.event(at, "snapshot", radios=[{"link": "gcs", **dict.fromkeys(RADIO, 7)}])
    ground.close()
    raw.write(tmp_path, events)
    names = {plot["name"].split(" ", 1)[1] for plot in report(tmp_path)["plots"] if plot["agent"] != "ground"}
    assert names == set(wanted)
    for name in [*names, *RADIO]:
        assert next(title for key, title, _ in GROUPS if name.startswith(key))
    assert {key for key in PLOTTED if any(name.startswith(key) for name in names)} == set(PLOTTED)


def test_runs_that_do_not_fit_when_pieces_are_merged_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As those that do not fit within one piece."""
    monkeypatch.setattr("phm.review.part.MOST_RUNS", 1)
    first, second = Part(), Part()
    for part, boot in ((first, "a"), (second, "b")):
        run = part.runs["agent", boot] = Run("agent", 1, boot)
        run.lines = 4
    first.merge(second)
    assert {what: count for (what, _), (count, _) in first.problems.found.items()} == {
        "more runs of PHM than a report takes": 4
    }


def test_lines_that_the_record_of_the_ground_lacks_are_counted(tmp_path: Path) -> None:
    """An event `lost` counts 10 lines, and has the number of the last one; 3 more are in no file, of which no line says anything."""
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(0, "slots", agent=7, name="A07", slots={"6": "OK"})
    ground.number += 9
    ground.event(30, "lost", lines=10, reason="disk full")
    ground.event(40, "snapshot")
    ground.number += 3
    ground.event(60, "slots", agent=7, name="A07", slots={"6": "WARN"})
    ground.event(80, "snapshot")
    made = report(ground.close())
    (row,) = made["files"]["grounds"]
    assert (row["lost_lines"], row["missing_lines"], row["left_out"]) == (10, 3, 0)
    table = next(table for table in tables.tables(made) if table[0] == "Not in this report")
    assert table[2] == [
        ("ground", "lines that PHM could not write", "10"),
        ("ground", "lines that are missing in the logs", "3"),
    ]
    assert made["sentences"][4] == "Before the next flight, check the disks: 13 lines of the logs are missing."
