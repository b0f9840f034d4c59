"""A dataset of many flights is read by other programs without conversion, and gives MTBF and MTTR by one query."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.dataset
import pyarrow.parquet
import pytest

from phm.core.file_lock import locked
from phm.core.model import Fault, FaultClosed, Outcome
from phm.review import parquet, record, record_reader
from tests.review.records import T0, Flown, report
from tests.review.test_command import phm
from tests.review.test_document import one_flight

REPORT = Path(__file__).resolve().parents[2] / "docs" / "reference" / "report.md"


def add(folder: Path, dataset: Path) -> dict[str, int]:
    return parquet.write(record.build(record_reader.read(record_reader.find([str(folder)]))), str(dataset))


def rates(dataset: Path, check: str = "nodes") -> dict[str, Any]:
    return next(row for row in parquet.rates(str(dataset)) if row["check"] == check)


def rows(dataset: Path, table: str, columns: str) -> list[tuple[Any, ...]]:
    query = f"SELECT {columns} FROM read_parquet(?, hive_partitioning = true) ORDER BY ALL"
    return duckdb.execute(query, [f"{dataset}/{table}/**/*.parquet"]).fetchall()


def test_every_table_has_the_columns_of_the_documents(tmp_path: Path) -> None:
    """Read back by Arrow and by DuckDB, with day and agent from the folders."""
    one_flight(tmp_path / "log").close()
    counts = add(tmp_path / "log", tmp_path / "set")
    for table, schema in parquet.SCHEMAS.items():
        read = pyarrow.dataset.dataset(tmp_path / "set" / table, partitioning="hive").to_table()
        assert [*read.column_names] == ["run", *(column for column, _ in schema), "day", "agent"]
        assert read.num_rows == counts[table] > 0
    columns = "unit, epoch(opened), lasted_s, outcome, armed, continued, CAST(day AS VARCHAR), agent"
    assert rows(tmp_path / "set", "faults", columns) == [
        ("container/ros_app", T0 + 400, 100.0, "open", False, False, "2026-03-01", "agent_1"),
        ("nodes/node_1", T0 + 150, 4.0, "resolved", True, False, "2026-03-01", "agent_1"),
    ]


def test_the_types_of_the_documents_are_those_of_the_files(tmp_path: Path) -> None:
    """Each table of report.md names each column with its Parquet type, in the order of the file."""
    text = REPORT.read_text("utf-8").partition("\n## Many flights\n")[2].partition("\n## ")[0]
    tables = re.findall(r"^\| `(\w+)` \| (.*) \|$", text, re.MULTILINE)
    documented = {table: re.findall(r"`(\w+)` (string|double|int32|bool|timestamp)\b", cell) for table, cell in tables}
    one_flight(tmp_path / "log").close()
    add(tmp_path / "log", tmp_path / "set")
    written = {}
    for table in parquet.SCHEMAS:
        (file,) = (tmp_path / "set" / table).rglob("*.parquet")
        schema = pyarrow.parquet.read_schema(file)
        types = [(one.name, str(one.type).replace("timestamp[ms, tz=UTC]", "timestamp")) for one in schema]
        assert (types[0], schema.metadata) == (("run", "string"), {b"phm_parquet": str(parquet.VERSION).encode()})
        written[table] = types[1:]
    assert documented == written


def test_a_record_that_is_added_again_replaces_itself(tmp_path: Path) -> None:
    """The rates do not count a flight twice."""
    one_flight(tmp_path / "log").close()
    for _ in range(2):
        add(tmp_path / "log", tmp_path / "set")
    row = rates(tmp_path / "set")
    assert (row["runs"], row["faults"], row["observed_s"], row["mtbf_s"], row["mttr_s"]) == (1, 1, 500.0, 500.0, 4.0)


def test_a_folder_that_grew_is_counted_once(tmp_path: Path) -> None:
    """Reported today, and tomorrow with one more run: each run counts once, in whatever company it is reported."""
    made = Flown(tmp_path / "logs" / "1")
    made.until(50)
    made.fail("nodes/node_1")
    made.until(100)
    made.report()
    made.close()
    add(tmp_path / "logs", tmp_path / "set")
    second = Flown(tmp_path / "logs" / "2", boot="boot0002", start=86_400.0)
    second.until(86_900)
    second.close()
    for reported in (tmp_path / "logs", tmp_path / "logs" / "2"):
        add(reported, tmp_path / "set")
        row = rates(tmp_path / "set")
        assert (row["runs"], row["faults"], row["observed_s"], row["mtbf_s"]) == (2, 1, 600.0, 600.0)
    counted = {
        row["check"]: (row["faults"], row["observed_s"], row["mttr_s"]) for row in report(tmp_path / "logs")["checks"]
    }
    assert counted == {
        row["check"]: (row["faults"], row["observed_s"], row["mttr_s"]) for row in parquet.rates(str(tmp_path / "set"))
    }
    days = [("2026-03-01",), ("2026-03-02",)]
    for table in ("runs", "metrics", "levels"):
        assert sorted({*rows(tmp_path / "set", table, "CAST(day AS VARCHAR)")}) == days


def test_a_fault_that_stays_open_over_a_restart_is_one_fault_however_its_runs_are_reported(tmp_path: Path) -> None:
    """The run where it opened has it; a run that only saw its end says so, and does not count it."""
    one = Flown(tmp_path / "logs" / "1")
    one.until(60)
    fault = one.fail("nodes/node_1", lasts=None)
    one.until(100)
    one.close()
    two = Flown(tmp_path / "logs" / "2", boot="boot0002", start=160.0, mono=50.0)
    two.until(200)
    state = two._state("nodes/node_1", two.states["nodes/node_1"].level)
    opened = replace(two.at, utc=T0 + 60, mono=two.at.mono - 140)
    ended = Fault(fault, "nodes/node_1", state.slot, state.layer, state.result, opened)
    two.log.handle(FaultClosed(two.at, replace(ended, closed=two.at, outcome=Outcome.RESOLVED, by="itself")))
    two.until(260)
    two.close()
    columns = "fault, outcome, lasted_s, continued"
    for place, order in enumerate((("1", "2"), ("2", "1"), ("",), ("", "2"), ("1", ""))):
        dataset = tmp_path / f"set{place}"
        for reported in order:
            add(tmp_path / "logs" / reported, dataset)
        assert rates(dataset)["faults"] == 1
        whole, alone = (fault, "resolved", 140.0, False), (fault, "resolved", 140.0, True)
        opened_alone = (fault, "open", 40.0, False)
        expected = {("",): [whole], ("1", ""): [whole], ("", "2"): [whole, alone]}.get(order, [opened_alone, alone])
        assert sorted(rows(dataset, "faults", columns), key=str) == sorted(expected, key=str)


def test_rows_that_a_run_no_longer_has_leave_the_dataset(tmp_path: Path) -> None:
    """A clock that was put right moves the run to another day, and a fault that is not in the log any more goes."""
    made = Flown(tmp_path / "log", wrong_s=-86_400.0)
    made.until(50)
    made.fail("nodes/node_1")
    made.until(100)
    made.close()
    add(tmp_path / "log", tmp_path / "set")
    (tmp_path / "log" / "phm.jsonl").unlink()
    again = Flown(tmp_path / "log")
    again.until(100)
    again.close()
    add(tmp_path / "log", tmp_path / "set")
    assert rates(tmp_path / "set")["faults"] == 0
    assert {path.parent.parent.name for path in (tmp_path / "set").rglob("*.parquet")} == {"day=2026-03-01"}


def test_a_write_that_is_interrupted_leaves_whole_files_and_counts_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ended before any of its files is moved, the dataset is as before; ended later, it is right after the next report."""
    one_flight(tmp_path / "log").close()
    add(tmp_path / "log", tmp_path / "set")
    whole = parquet.rates(str(tmp_path / "set"))
    left = 0

    def move(source: Path, target: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        os.rename(source, target)

    monkeypatch.setattr(os, "replace", move)
    for count in (0, 3):
        left = count
        with pytest.raises(KeyboardInterrupt):
            add(tmp_path / "log", tmp_path / "set")
        assert parquet.rates(str(tmp_path / "set")) == whole
    monkeypatch.undo()
    half = tmp_path / "set" / parquet.STAGED / "faults" / "day=2026-03-01" / "agent=agent_1"
    half.mkdir(parents=True)  # as after SIGKILL
    (half / "run-x.parquet").write_bytes(b"PAR1")
    add(tmp_path / "log", tmp_path / "set")
    assert parquet.rates(str(tmp_path / "set")) == whole
    assert not (tmp_path / "set" / parquet.STAGED).exists()


def test_two_reports_do_not_write_into_one_dataset_at_once(tmp_path: Path) -> None:
    """The second one ends with an error that says so, and writes nothing."""
    one_flight(tmp_path / "log").close()
    (tmp_path / "set").mkdir()
    with locked(tmp_path / "set" / parquet.LOCK, AssertionError()):
        result = phm(tmp_path / "log", "--parquet", tmp_path / "set")
    assert (
        result.exit_code == 1 and "another `phm report --parquet` writes into it: run this one again" in result.output
    )
    assert [path.name for path in (tmp_path / "set").iterdir()] == [parquet.LOCK]


def test_a_dataset_of_an_earlier_version_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """Its files have runs that cannot be distinguished, so they would count twice; nothing is written into it."""
    one_flight(tmp_path / "log").close()
    old = tmp_path / "set" / "checks" / "day=2026-03-01" / "agent=agent_1" / "2026-03-01T12_00_00Z-12345678.parquet"
    old.parent.mkdir(parents=True)
    old.write_bytes(b"PAR1")
    result = phm(tmp_path / "log", "--parquet", tmp_path / "set")
    assert result.exit_code == 1
    assert f"{old.relative_to(tmp_path / 'set')} is of an earlier version of PHM" in result.output
    assert "report the logs again into a new folder" in result.output
    assert [*(tmp_path / "set").rglob("*.parquet")] == [old]


def test_mtbf_over_many_flights_is_that_of_all_their_time_together(tmp_path: Path) -> None:
    """Also of checks without a fault, and of flights without one."""
    for number, faults in enumerate((0, 1, 3)):
        made = Flown(tmp_path / f"log{number}", boot=f"boot{number:04d}")
        for place in range(faults):
            made.until(50 * (place + 1))
            made.fail("nodes/node_1", lasts=2.0 + place)
        made.until(400)
        made.report()
        made.close()
        add(tmp_path / f"log{number}", tmp_path / "set")
        if number == 0:
            assert {row["mtbf_s"] for row in parquet.rates(str(tmp_path / "set"))} == {None}
    nodes = rates(tmp_path / "set")
    assert (nodes["runs"], nodes["faults"], nodes["observed_s"], nodes["mtbf_s"], nodes["mttr_s"]) == (
        3,
        4,
        1200.0,
        300.0,
        2.75,
    )
    topics = rates(tmp_path / "set", "rates")
    assert (topics["faults"], topics["mtbf_s"], topics["mtbf_low_s"]) == (0, None, pytest.approx(325.3, abs=0.1))


def test_names_from_a_record_stay_inside_the_dataset(tmp_path: Path) -> None:
    """An agent called ../../x, and a run of that name, are folders and files of the dataset, not beside it."""
    log = one_flight(tmp_path / "log").close()
    text = log.read_bytes().replace(b'"agent":"agent_1"', b'"agent":"../../x"')
    log.write_bytes(text.replace(b'"boot_id":"boot0001"', b'"boot_id":"../../../../../y"'))
    add(tmp_path / "log", tmp_path / "deep" / "set")
    assert {path.name for path in tmp_path.iterdir()} == {"log", "deep"}
    made = [path.relative_to(tmp_path / "deep" / "set") for path in (tmp_path / "deep").rglob("*.parquet")]
    assert {path.parent.parent.name for path in made} == {"day=2026-03-01"}
    assert all(re.fullmatch(r"agent=\.\._\.\._x-[0-9a-f]{6}", path.parent.name) for path in made)
    assert all(re.fullmatch(r"run-_{15}y-[0-9a-f]{12}\.parquet", path.name) for path in made)


def test_a_folder_without_a_dataset_is_a_sentence(tmp_path: Path) -> None:
    """It says how to make one."""
    with pytest.raises(parquet.DatasetError, match=r"no dataset in .*: write one with"):
        parquet.rates(str(tmp_path))


def test_a_dataset_grows_with_each_report_and_gives_its_rates(tmp_path: Path) -> None:
    """`--parquet` adds the record, and the report has MTBF and MTTR over all of them."""
    one_flight(tmp_path / "one").close()
    one_flight(tmp_path / "two", boot="boot0002").close()
    phm(tmp_path / "one", "--parquet", tmp_path / "set")
    result = phm(tmp_path / "two", "--parquet", tmp_path / "set", "--json")
    found = {row["check"]: row for row in json.loads(result.output)["dataset"]["checks"]}
    assert (found["nodes"]["runs"], found["nodes"]["faults"], found["nodes"]["mtbf_s"]) == (2, 2, 500.0)
    assert "Checks, all runs of the dataset" in phm(tmp_path / "two", "--parquet", tmp_path / "set").output
