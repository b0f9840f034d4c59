"""Many flights as a partitioned Parquet dataset, and MTBF and MTTR of all of them by one query.

The schema is a contract: docs/reference/report.md. Needs pyarrow; the query needs duckdb.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.review.record import AgentRecord, Record
from phm.review.statistics import rate_limits
from phm.wire.report import iso

Json = dict[str, Any]
VERSION = 1
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
"""Columns of each table, after `record` and before the partitions `day` and `agent`."""
MTBF = """
SELECT observed."check", coalesce(count, 0) AS faults, observed_s,
       observed_s / nullif(count, 0) AS mtbf_s, mttr_s, observed.records AS records
FROM (SELECT "check", sum(observed_s) AS observed_s, count(DISTINCT record) AS records
      FROM read_parquet($checks, hive_partitioning = true) GROUP BY "check") AS observed
LEFT JOIN (SELECT "check", count(*) AS count, avg(lasted_s) FILTER (outcome = 'resolved') AS mttr_s
           FROM read_parquet($faults, hive_partitioning = true) WHERE outcome <> 'reattributed' GROUP BY "check") AS failed
USING ("check") ORDER BY faults DESC, observed."check"
"""
"""MTBF and MTTR of each check over all records of a dataset; $checks and $faults are lists of its files."""


class NotADataset(Exception):
    """The folder has no tables; the message says what to do."""


def name_of(record: Record) -> str:
    """The same for the same record: its beginning, and a digest of its runs."""
    runs = " ".join(sorted(f"{agent.id} {run.boot_id}" for agent in record.agents for run, _ in agent.runs))
    return f"{iso(record.begin)[:19]}Z-{hashlib.sha256(runs.encode()).hexdigest()[:8]}"


def write(record: Record, folder: str, name: str) -> dict[str, int]:
    """Add a record to the dataset in the folder. A record of the same name is replaced. Returns the rows of each table.

    name: identifies the record, in the column `record` and in the names of the files.
    """
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {
        "string": pa.string(),
        "double": pa.float64(),
        "int32": pa.int32(),
        "bool": pa.bool_(),
        "timestamp": pa.timestamp("ms", tz="UTC"),
    }
    safe = re.sub(r"[^\w.-]", "_", name)[:80] or "record"
    counts: dict[str, int] = {}
    for table in SCHEMAS:  # an empty table has no file, so what an earlier record of this name had goes first
        for old in Path(folder, table).glob(f"day=*/agent=*/{safe}.parquet"):
            old.unlink()
    for agent in record.agents:
        day = iso(agent.cover[0][0])[:10] if agent.cover else "unknown"
        place = f"day={day}/agent={_folder(agent.name)}"
        for table, rows in _tables(agent).items():
            if not rows:
                continue
            columns = {"record": pa.array([name] * len(rows), pa.string())}
            for place_of, (column, kind) in enumerate(SCHEMAS[table]):
                values = [row[place_of] for row in rows]
                if kind == "timestamp":
                    values = [None if value is None else round(value * 1000) for value in values]
                elif kind == "int32":
                    values = [_small(value) for value in values]
                columns[column] = pa.array(values, kinds[kind])
            target = Path(folder, table, place)
            target.mkdir(parents=True, exist_ok=True)
            metadata = {"phm_parquet": str(VERSION)}
            parquet.write_table(
                pa.table(columns).replace_schema_metadata(metadata), target / f"{safe}.parquet", compression="zstd"
            )
            counts[table] = counts.get(table, 0) + len(rows)
    return counts


def _folder(name: str) -> str:
    """A name as part of a path. Different names have different ones."""
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:80]
    return safe if safe == name else f"{safe}-{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def _small(value: int | None) -> int | None:
    """None for what cannot be the number of a slot or attempt."""
    return value if value is not None and abs(value) < 2**31 else None


def rates(folder: str) -> list[Json]:
    """MTBF and MTTR of each check over all records in the folder, by one query. Raises NotADataset."""
    import duckdb

    files = {table: sorted(map(str, Path(folder, table).rglob("*.parquet"))) for table in ("checks", "faults")}
    if not files["checks"]:
        raise NotADataset(f"no dataset in {folder}: write one with `phm report PATH... --parquet {folder}`")
    query, used = (MTBF, files) if files["faults"] else (_WITHOUT_FAULTS, {"checks": files["checks"]})
    with duckdb.connect() as connection:
        return [_rate(row) for row in connection.execute(query, used).fetchall()]


_WITHOUT_FAULTS = """
SELECT "check", 0, sum(observed_s), NULL, NULL, count(DISTINCT record)
FROM read_parquet($checks, hive_partitioning = true) GROUP BY "check" ORDER BY "check"
"""


def _rate(row: tuple[Any, ...]) -> Json:
    check, faults, observed_s, mtbf_s, mttr_s, records = row
    low, high = rate_limits(faults, observed_s)
    return {
        "check": check,
        "records": records,
        "faults": faults,
        "observed_s": round(observed_s, 3),
        "mtbf_s": None if mtbf_s is None else round(mtbf_s, 3),
        "mtbf_low_s": round(1 / high, 3) if high else None,
        "mtbf_high_s": round(1 / low, 3) if low else None,
        "mttr_s": None if mttr_s is None else round(mttr_s, 3),
    }


def _tables(agent: AgentRecord) -> dict[str, list[tuple[Any, ...]]]:
    from phm.review import levels

    units = levels.of_units(agent)
    return {
        "runs": list(_runs(agent)),
        "checks": list(_checks(agent)),
        "faults": [_fault(agent, fault) for fault in agent.faults],
        "actions": [
            (
                t,
                mark.body["fault"],
                mark.body["unit"],
                mark.body["action"],
                mark.body["phase"],
                mark.body["attempt"],
                mark.body["target"],
                mark.text,
            )
            for t, mark in agent.marks
            if mark.what == "action"
        ],
        "levels": [(unit, *segment) for unit, segments in units.items() for segment in segments],
        "metrics": [
            (clock.t(at), name, value)
            for run, clock in agent.runs
            for name, series in run.series.items()
            for at, value in series.points()
        ],
    }


def _runs(agent: AgentRecord) -> Iterator[tuple[Any, ...]]:
    from phm.review.spans import clipped, total

    for run, clock in agent.runs:
        spans = [[clock.t(begin), clock.t(end)] for begin, end in run.cover.spans]
        if spans:
            armed_s = sum(total(clipped(agent.armed, *span)) for span in spans)
            yield run.boot_id, run.version, spans[0][0], spans[-1][1], armed_s, total(spans)


def _checks(agent: AgentRecord) -> Iterator[tuple[Any, ...]]:
    """For how long each check was run: the time of PHM on an agent that has it."""
    from phm.review.spans import clipped, total

    armed_s = sum(total(clipped(agent.armed, *span)) for span in agent.cover)
    for check in sorted({body["check"] for run, _ in agent.runs for body in run.units.values()}):
        yield check, total(agent.cover), armed_s


def _fault(agent: AgentRecord, fault: Json) -> tuple[Any, ...]:
    lasted = (fault["closed"] if fault["closed"] is not None else agent.end) - fault["opened"]
    armed = any(begin <= fault["opened"] <= end for begin, end in agent.armed)
    keys = ("fault", "unit", "check", "slot", "layer", "condition", "target", "opened", "closed")
    outcome = fault["outcome"] if fault["closed"] is not None else "open"
    return (*(fault[key] for key in keys), lasted, outcome, fault["by"], armed, fault["summary"])
