"""Many flights as a partitioned Parquet dataset, and MTBF and MTTR of all of them by one query.

One file of each table for each run of PHM, so that a run counts once, however often and in whatever company it is reported. The
schema is a contract: docs/reference/report.md. Needs pyarrow; the query needs duckdb.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phm.core.file_lock import locked
from phm.review import parquet_rows
from phm.review.agent_run import Run
from phm.review.record import Record
from phm.review.statistics import rate_limits
from phm.wire.report import iso

Json = dict[str, Any]
VERSION = 2
LOCK, STAGED = ".lock", ".writing"
SCHEMAS: dict[str, tuple[tuple[str, str], ...]] = {
    "runs": (
        ("boot_id", "string"),
        ("version", "string"),
        ("begin", "timestamp"),
        ("end", "timestamp"),
        ("armed_s", "double"),
        ("ran_s", "double"),
    ),
    "checks": (("check", "string"), ("observed_s", "double"), ("armed_s", "double")),
    "faults": (
        ("fault", "string"),
        ("unit", "string"),
        ("check", "string"),
        ("slot", "int32"),
        ("layer", "string"),
        ("condition", "string"),
        ("target", "string"),
        ("opened", "timestamp"),
        ("closed", "timestamp"),
        ("lasted_s", "double"),
        ("outcome", "string"),
        ("by", "string"),
        ("armed", "bool"),
        ("continued", "bool"),
        ("summary", "string"),
    ),
    "actions": (
        ("t", "timestamp"),
        ("fault", "string"),
        ("unit", "string"),
        ("action", "string"),
        ("phase", "string"),
        ("attempt", "int32"),
        ("target", "string"),
        ("detail", "string"),
    ),
    "levels": (("unit", "string"), ("begin", "timestamp"), ("end", "timestamp"), ("level", "string")),
    "metrics": (("t", "timestamp"), ("name", "string"), ("value", "double")),
}
"""Columns of each table, after `run` and before the partitions `day` and `agent`."""
MTBF = """
SELECT observed."check", coalesce(count, 0) AS faults, observed_s, observed_s / nullif(count, 0) AS mtbf_s, mttr_s, runs
FROM (SELECT "check", sum(observed_s) AS observed_s, count(*) AS runs
      FROM read_parquet($checks, hive_partitioning = true) GROUP BY "check") AS observed
LEFT JOIN (SELECT "check", count(*) AS count, avg(lasted_s) FILTER (
          outcome = 'resolved' AND "by" NOT IN ('configuration', 'timeout')) AS mttr_s
           FROM read_parquet($faults, hive_partitioning = true)
           WHERE outcome <> 'reattributed' AND NOT continued GROUP BY "check") AS failed
USING ("check") ORDER BY faults DESC, observed."check"
"""
"""MTBF and MTTR of each check over all runs of a dataset; $checks and $faults are lists of its files. The names are those of
`phm.core.model.NOT_OBSERVED`."""
_WITHOUT_FAULTS = """
SELECT "check", 0, sum(observed_s), NULL, NULL, count(*)
FROM read_parquet($checks, hive_partitioning = true) GROUP BY "check" ORDER BY "check"
"""


class DatasetError(Exception):
    """The folder cannot be used as a dataset; the message says what to do."""


def write(record: Record, folder: str) -> dict[str, int]:
    """Add the runs of a record to the dataset in the folder; those that it has are replaced. Returns the rows of each table.

    A reader finds whole files only. Raises DatasetError, OSError.
    """
    whole = Path(folder)
    whole.mkdir(parents=True, exist_ok=True)
    with locked(
        whole / LOCK, DatasetError("another `phm report --parquet` writes into it: run this one again after it")
    ):
        return _write(record, whole)


def _write(record: Record, folder: Path) -> dict[str, int]:
    had, staged, rows = _files(folder), folder / STAGED, Counter[str]()
    shutil.rmtree(staged, ignore_errors=True)  # of one that was killed
    written: set[Path] = set()
    try:
        for agent in record.agents:
            for run, tables in parquet_rows.by_run(agent):
                for table, values in tables.items():
                    if values:
                        path = Path(table, f"day={_day(tables)}", f"agent={_folder(agent.name)}", _file(run))
                        _write_table(staged / path, table, run_name(run), values)
                        written.add(path)
                        rows[table] += len(values)
        runs = {_file(run) for agent in record.agents for run, _ in agent.runs}
        # What a run no longer has goes first: if this is interrupted, a run may be missing, but none counts twice.
        for old in (path for files in had.values() for path in files):
            if old.name in runs and old.relative_to(folder) not in written:
                old.unlink(missing_ok=True)
        for path in sorted(written):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            os.replace(staged / path, folder / path)
    finally:
        shutil.rmtree(staged, ignore_errors=True)
    return dict(rows)


def _write_table(path: Path, table: str, run: str, rows: Sequence[tuple[Any, ...]]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {
        "string": pa.string(),
        "double": pa.float64(),
        "int32": pa.int32(),
        "bool": pa.bool_(),
        "timestamp": pa.timestamp("ms", tz="UTC"),
    }
    columns = {"run": pa.array([run] * len(rows), pa.string())}
    for place, (column, kind) in enumerate(SCHEMAS[table]):
        values = [row[place] for row in rows]
        if kind == "timestamp":
            values = [None if value is None else round(value * 1000) for value in values]
        elif kind == "int32":
            values = [_small(value) for value in values]
        columns[column] = pa.array(values, kinds[kind])
    made = pa.table(columns).replace_schema_metadata({"phm_parquet": str(VERSION)})
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        parquet.write_table(made, stream, compression="zstd")
        stream.flush()
        os.fsync(stream.fileno())


def run_name(run: Run) -> str:
    """Identifies a run of PHM, in the column `run` and the names of the files: its boot_id, and a digest of it and the agent."""
    digest = hashlib.sha256(f"{run.agent}\0{run.boot_id}".encode()).hexdigest()[:12]
    return f"{re.sub('[^A-Za-z0-9]', '_', run.boot_id)[:40]}-{digest}"


def _file(run: Run) -> str:
    return f"run-{run_name(run)}.parquet"


def _day(tables: dict[str, parquet_rows.Rows]) -> str:
    """On which the run began."""
    return iso(tables["runs"][0][2])[:10]


def _files(folder: Path) -> dict[str, list[Path]]:
    """The files of each table. Raises DatasetError for one that is not of this version of PHM: a flight in it might count twice."""
    found = {table: sorted(Path(folder, table).rglob("*.parquet")) for table in SCHEMAS}
    for path in (path for files in found.values() for path in files):
        if not path.name.startswith("run-"):
            raise DatasetError(
                f"{path.relative_to(folder)} is of an earlier version of PHM or another program, whose runs would count twice: "
                "report the logs again into a new folder"
            )
    return found


def _folder(name: str) -> str:
    """A name as part of a path. Different names have different ones."""
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:80]
    return safe if safe == name else f"{safe}-{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def _small(value: int | None) -> int | None:
    """None for what cannot be the number of a slot or attempt."""
    return value if value is not None and abs(value) < 2**31 else None


def rates(folder: str) -> list[Json]:
    """MTBF and MTTR of each check over all runs in the folder, by one query. Raises DatasetError."""
    import duckdb

    files = {
        table: [*map(str, paths)] for table, paths in _files(Path(folder)).items() if table in ("checks", "faults")
    }
    if not files["checks"]:
        raise DatasetError(f"no dataset in {folder}: write one with `phm report PATH... --parquet {folder}`")
    query, used = (MTBF, files) if files["faults"] else (_WITHOUT_FAULTS, {"checks": files["checks"]})
    with duckdb.connect() as connection:
        return [_rate(row) for row in connection.execute(query, used).fetchall()]


def _rate(row: tuple[Any, ...]) -> Json:
    check, faults, observed_s, mtbf_s, mttr_s, runs = row
    low, high = rate_limits(faults, observed_s)
    return {
        "check": check,
        "runs": runs,
        "faults": faults,
        "observed_s": round(observed_s, 3),
        "mtbf_s": None if mtbf_s is None else round(mtbf_s, 3),
        "mtbf_low_s": round(1 / high, 3) if high else None,
        "mtbf_high_s": round(1 / low, 3) if low else None,
        "mttr_s": None if mttr_s is None else round(mttr_s, 3),
    }
