"""A dataset of many flights is read by others as it is, and gives MTBF and MTTR by one query."""

from __future__ import annotations

import json
from pathlib import Path

import duckdb
import pyarrow.dataset
import pytest

from phm.review import gather, parquet, record
from tests.review.records import T0, Flown
from tests.review.test_command import phm
from tests.review.test_document import one_flight


def add(folder: Path, dataset: Path, name: str = "") -> dict[str, int]:
    merged = record.build(gather.read(gather.find([str(folder)])))
    return parquet.write(merged, str(dataset), name or parquet.name_of(merged))


def test_every_table_has_the_columns_of_the_documents(tmp_path: Path) -> None:
    """Read back by Arrow and by DuckDB, with day and agent from the folders."""
    one_flight(tmp_path / "log").close()
    rows = add(tmp_path / "log", tmp_path / "set")
    for table, schema in parquet.SCHEMAS.items():
        read = pyarrow.dataset.dataset(tmp_path / "set" / table, partitioning="hive").to_table()
        assert [*read.column_names] == ["record", *(column for column, _ in schema), "day", "agent"]
        assert read.num_rows == rows[table] > 0
    query = "SELECT unit, epoch(opened), lasted_s, outcome, armed, CAST(day AS VARCHAR), agent FROM read_parquet(?, hive_partitioning = true) ORDER BY opened"
    found = duckdb.execute(query, [f"{tmp_path}/set/faults/**/*.parquet"]).fetchall()
    assert found == [
        ("nodes/node_1", T0 + 150, 4.0, "resolved", True, "2026-03-01", "agent_1"),
        ("container/ros_app", T0 + 400, 100.0, "open", False, "2026-03-01", "agent_1"),
    ]


def test_a_record_that_is_added_again_replaces_itself(tmp_path: Path) -> None:
    """The rates do not count a flight twice."""
    one_flight(tmp_path / "log").close()
    for _ in range(2):
        add(tmp_path / "log", tmp_path / "set")
    row = next(row for row in parquet.rates(str(tmp_path / "set")) if row["check"] == "nodes")
    assert (row["records"], row["faults"], row["observed_s"], row["mtbf_s"], row["mttr_s"]) == (1, 1, 500.0, 500.0, 4.0)


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
        add(tmp_path / f"log{number}", tmp_path / "set", f"flight {number}")
        if number == 0:
            assert {row["mtbf_s"] for row in parquet.rates(str(tmp_path / "set"))} == {None}
    rows = {row["check"]: row for row in parquet.rates(str(tmp_path / "set"))}
    nodes = rows["nodes"]
    assert (nodes["records"], nodes["faults"], nodes["observed_s"], nodes["mtbf_s"], nodes["mttr_s"]) == (
        3,
        4,
        1200.0,
        300.0,
        2.75,
    )
    assert (rows["rates"]["faults"], rows["rates"]["mtbf_s"], rows["rates"]["mtbf_low_s"]) == (
        0,
        None,
        pytest.approx(325.3, abs=0.1),
    )


def test_names_from_a_record_stay_inside_the_dataset(tmp_path: Path) -> None:
    """An agent called ../../x is a folder of the dataset, not one beside it."""
    log = one_flight(tmp_path / "log").close()
    log.write_bytes(log.read_bytes().replace(b'"agent":"agent_1"', b'"agent":"../../x"'))
    add(tmp_path / "log", tmp_path / "deep" / "set", "../../name")
    assert {path.name for path in tmp_path.iterdir()} == {"log", "deep"}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["set"]


def test_a_folder_without_a_dataset_is_a_sentence(tmp_path: Path) -> None:
    """It says how to make one."""
    with pytest.raises(parquet.NotADataset, match=r"no dataset in .*: write one with"):
        parquet.rates(str(tmp_path))


def test_a_dataset_grows_with_each_report_and_gives_its_rates(tmp_path: Path) -> None:
    """`--parquet` adds the record, and the report has MTBF and MTTR over all of them."""
    one_flight(tmp_path / "one").close()
    one_flight(tmp_path / "two", boot="boot0002").close()
    phm(tmp_path / "one", "--parquet", tmp_path / "set")
    result = phm(tmp_path / "two", "--parquet", tmp_path / "set", "--json")
    rows = {row["check"]: row for row in json.loads(result.output)["dataset"]["checks"]}
    assert (rows["nodes"]["records"], rows["nodes"]["faults"], rows["nodes"]["mtbf_s"]) == (2, 2, 500.0)
    assert "Checks, all records of the dataset" in phm(tmp_path / "two", "--parquet", tmp_path / "set").output
