"""The report as tables of text: for the terminal, Markdown and CSV. Pure."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Any

from phm.review import table_rows
from phm.review.sentences import vehicles
from phm.wire.text import one_line

Json = dict[str, Any]
Table = tuple[str, tuple[str, ...], list[tuple[str, ...]]]
"""A table: its title, its header and its rows."""
COLUMNS = (
    "agent", "fault", "unit", "check", "slot", "layer", "condition", "target", "opened", "closed", "lasted_s", "acted_after_s",
    "outcome", "by", "brief", "summary", "consequences", "blocks", "suspects",
)  # fmt: skip
"""The columns of the CSV file, which has one row for each fault."""
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""A spreadsheet takes a cell that begins so for a formula; such cells of text begin with an apostrophe."""
MOST_ROWS = 30
FAULTS, AVAILABILITY = "Faults", "Availability below 100 %"
"""Titles of the tables that the page shows in full."""


def tables(document: Json, *, most: int = MOST_ROWS) -> list[Table]:
    """What the terminal and Markdown show. most: rows of a table; a last row counts the others."""
    found = [*_of_the_flight(document, most), *_of_the_record(document)]
    said = (one for one in found if one[2] or one[0].startswith(table_rows.OTHERS))  # its title says how many there are
    return [(title, head, _cut(rows, most, len(head))) for title, head, rows in said]


def _of_the_flight(document: Json, most: int) -> Iterator[Table]:
    if document["injection_metrics"]:
        yield (
            "Table 2 of the paper",
            ("metric", "paper", "this record"),
            table_rows.injection_metrics(document["injection_metrics"]),
        )
    head: tuple[str, ...] = ("agent", "faults", "in ERROR", "in WARN", "not known", "PHM ran", "armed")
    yield "Agents", head, [table_rows.agent(row) for row in vehicles(document)]
    head = ("flight", "began (UTC)", "lasted", "agents")
    yield "Flights", head, [table_rows.flight(row) for row in document["flights"]]
    head = ("agent", "at (UTC)", "fault", "unit", "lasted", "ended", "what")
    yield FAULTS, head, [table_rows.fault(row) for row in document["faults"]]
    checks = [table_rows.check(row) for row in document["checks"] if row["faults"]]
    yield "Checks", ("check", "faults", "MTBF (95 %)", "MTTR"), checks
    if "dataset" in document:
        head = ("check", "runs", "faults", "MTBF (95 %)", "MTTR")
        yield "Checks, all runs of the dataset", head, [_of_dataset(row) for row in document["dataset"]["checks"]]
    if document["other"]["rows"] or document["other"]["outside"]:
        yield table_rows.others(document["other"], most)
    low = [row for row in document["availability"] if row["availability"] is not None and row["availability"] < 1]
    low.sort(key=lambda row: float(row["availability"]))
    yield AVAILABILITY, ("agent", "of", "availability", "in ERROR", "not known"), list(map(table_rows.available, low))
    head = ("agent", "unit", "cause unknown", "because of a fault")
    yield "What was not known", head, [table_rows.unknown(row) for row in document["unknown"]]


def _of_the_record(document: Json) -> Iterator[Table]:
    head: tuple[str, ...] = ("agent", "ran", "restarts", "reloads", "reports", "report takes", "longest")
    cost = ("CPU", "memory", "sent", "text received from it")
    yield "PHM itself", head + cost, [table_rows.phm(row) for row in document["phm"]["agents"]]
    clocks = [table_rows.clock(row) for row in document["clocks"]["runs"]]
    if clocks:
        clocks += [table_rows.external_clock(row) for row in document["clocks"]["others"]]
    yield "Clocks", ("agent", "run", "offset", "error", "by"), clocks
    more = document["files"]["more_problems"]
    rows: list[tuple[str, ...]] = [("problems of other kinds or files", str(more), "")] if more else []
    rows += [table_rows.problem(row) for row in document["files"]["problems"]]
    yield "Not read", ("problem", "how often", "first in"), rows
    yield "Not in this report", ("agent", "what", "how many"), table_rows.cut(document)


def _of_dataset(row: Json) -> tuple[str, ...]:
    check, *rest = table_rows.check(row)
    return (check, str(row["runs"]), *rest)


def markdown(document: Json) -> str:
    """The report as Markdown, for an issue or a wiki."""
    missing = document["clocks"]["missing"]
    said = [*document["sentences"], *([f"Times: {missing}."] if missing else [])]
    return markdown_of("Flight report", said, tables(document, most=10_000))


def markdown_of(title: str, sentences: Sequence[str], shown: Sequence[Table]) -> str:
    """Sentences and tables as Markdown. Their text is escaped."""
    parts = [f"# {title}", "", *(_cell(sentence) for sentence in sentences), ""]
    for name, head, rows in shown:
        parts += [f"## {name}", "", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
        parts += [f"| {' | '.join(map(_cell, row))} |" for row in rows]
        parts.append("")
    return "\n".join(parts)


def faults_csv(document: Json) -> str:
    """One row for each fault, RFC 4180; times in seconds since 1970, lists joined by spaces."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(COLUMNS)
    for fault in document["faults"]:
        writer.writerow([_csv(fault[column]) for column in COLUMNS])
    return out.getvalue()


def _cut(rows: Sequence[tuple[str, ...]], most: int, width: int) -> list[tuple[str, ...]]:
    kept = [tuple(one_line(cell) for cell in row) for row in rows[:most]]
    if len(rows) > most:
        kept.append((f"and {len(rows) - most} more", *[""] * (width - 1)))
    return kept


def _cell(text: str) -> str:
    """A cell of Markdown; text from a log is escaped."""
    escaped = one_line(text)
    for sign in "\\`*_[]<>|#":
        escaped = escaped.replace(sign, f"\\{sign}" if sign not in "<>" else {"<": "&lt;", ">": "&gt;"}[sign])
    return escaped


def _csv(value: object) -> object:
    if isinstance(value, list):
        value = " ".join(map(str, value))
    if not isinstance(value, str):
        return value
    return f"'{one_line(value)}" if value.startswith(FORMULA) else one_line(value)
