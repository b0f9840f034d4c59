"""The report as tables of text: for the terminal, Markdown and CSV. Pure."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

from phm.review.sentences import length, vehicles
from phm.review.table2 import PAPER
from phm.wire.report import clock_text
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


def tables(document: Json, *, most: int = MOST_ROWS) -> list[Table]:
    """What the terminal and Markdown show. most: rows of a table; a last row counts the others."""
    found: list[Table] = []
    head: tuple[str, ...]
    if document["table2"]:
        found.append(("Table 2 of the paper", ("metric", "paper", "this record"), table2_rows(document["table2"])))
    found.append(
        (
            "Agents",
            ("agent", "faults", "ERROR", "WARN", "unknown", "PHM ran", "armed"),
            [_agent(row) for row in vehicles(document)],
        )
    )
    if document["faults"]:
        head = ("agent", "at (UTC)", "fault", "unit", "lasted", "ended", "what")
        found.append(("Faults", head, [_fault(row) for row in document["faults"]]))
        checks = [_check(row) for row in document["checks"] if row["faults"]]
        found.append(("Checks", ("check", "faults", "MTBF (95 %)", "MTTR"), checks))
    if "dataset" in document:
        rows = [(*_check(row)[:1], str(row["runs"]), *_check(row)[1:]) for row in document["dataset"]["checks"]]
        found.append(("Checks, all runs of the dataset", ("check", "runs", "faults", "MTBF (95 %)", "MTTR"), rows))
    if document["other"]["rows"] or document["other"]["outside"]:
        found.append(_others(document["other"], most))
    low = [row for row in document["availability"] if row["availability"] is not None and row["availability"] < 1]
    if low:
        head = ("agent", "of", "availability", "in ERROR", "unknown")
        found.append(
            (
                "Availability below 100 %",
                head,
                [_available(row) for row in sorted(low, key=lambda row: float(row["availability"]))],
            )
        )
    if document["clocks"]["runs"]:
        head = ("agent", "run", "offset", "error", "by")
        found.append(
            (
                "Clocks",
                head,
                [_clock(row) for row in document["clocks"]["runs"]]
                + [_other_clock(row) for row in document["clocks"]["others"]],
            )
        )
    if document["files"]["problems"] or document["files"]["more_problems"]:
        head = ("problem", "how often", "first in")
        more = document["files"]["more_problems"]
        rows = [("problems of other kinds or files", str(more), "")] if more else []
        found.append(("Not read", head, rows + [_problem(row) for row in document["files"]["problems"]]))
    return [(title, head, _cut(rows, most, len(head))) for title, head, rows in found]


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


def table2_rows(table: Json) -> list[tuple[str, ...]]:
    """The rows of the paper, with what this record says."""
    interval = " / ".join(f"{each:g} s" for each in table["interval_s"]) or "-"
    return [
        ("Parameter: Reactivation Interval", f"{PAPER['interval_s']:g} s", interval),
        ("Parameter: SITL Agents", f"{PAPER['agents']:g}", str(table["agents"])),
        ("Faults injected", "not stated", f"{table['injected']}, {table['detected']} detected"),
        ("Average PHM Response", f"{PAPER['response_s']} s", _seconds(table["response_s"])),
        ("Average Fault Detection", f"{PAPER['detection_s']} s", _seconds(table["detection_s"])),
        ("First alarm", "not stated", _seconds(table["first_alarm_s"])),
        ("Self-Resolved Faults", f"{100 * PAPER['self_resolved']:.1f} %", _percent(table["self_resolved"], 1)),
        ("PHM Uptime", f"{100 * PAPER['phm_uptime']:.2f} %", _percent(table["phm_uptime"], 2)),
    ]


def _agent(row: Json) -> tuple[str, ...]:
    armed = sum(end - begin for begin, end in row["armed"])
    times = (length(row["error_s"]), length(row["warn_s"]), length(row["unknown_s"]))
    name = row["agent"] if row["logged"] else f"{row['agent']} (no log)"
    return (name, str(row["faults"]), *times, _percent(row["uptime"], 2), length(armed))


def _fault(row: Json) -> tuple[str, ...]:
    ways = {"resolved": f"by {row['by'] or 'itself'}", "reattributed": f"follows from {row['by']}"}
    ended = ways.get(str(row["outcome"]), str(row["outcome"]))
    when = clock_text(row["opened"])
    return (
        row["agent"],
        when,
        row["fault"],
        row["unit"],
        length(row["lasted_s"]),
        ended,
        row["brief"] or row["summary"],
    )


def _check(row: Json) -> tuple[str, ...]:
    high = length(row["mtbf_high_s"]) if row["mtbf_high_s"] else "more"
    mean = length(row["mtbf_s"]) if row["faults"] else "no fault"
    return (
        row["check"],
        str(row["faults"]),
        f"{mean} ({length(row['mtbf_low_s'])} to {high})",
        _seconds(row["mttr_s"]),
    )


def _available(row: Json) -> tuple[str, ...]:
    name = row["kind"] if row["kind"] == "agent" else f"{row['kind']} {row['name']}"
    return (row["agent"], name, _percent(row["availability"], 3), length(row["error_s"]), length(row["unknown_s"]))


def _clock(row: Json) -> tuple[str, ...]:
    offset = "unknown" if row["offset_s"] is None else f"{row['offset_s']:+.2f} s"
    offset += "" if row["applied"] or row["offset_s"] is None else " (within its error, not applied)"
    steps = f"; its UTC jumped {len(row['steps'])} times" if row["steps"] else ""
    return (row["agent"], row["boot_id"], offset, _seconds(row["error_s"]), (row["by"] or "its own clock") + steps)


def _other_clock(row: Json) -> tuple[str, ...]:
    offset = "unknown" if row["offset_s"] is None else f"{row['offset_s']:+.2f} s"
    by = f"{row['lines']} {row['by']}" if row["applied"] else row["by"]
    return (row["file"], "-", offset, _seconds(row["error_s"]), by)


def _others(other: Json, most: int) -> Table:
    """What others recorded; texts and topics without a level only where there is room for all."""
    rows = other["rows"]
    if len(rows) > most:
        rows = [row for row in rows if row["level"] or row["what"] not in ("statustext", "topic")]
    outside = f"; {other['outside']} more are not in the time of this report" if other["outside"] else ""
    outside += f"; the last {other['left_out']} are left out" if other["left_out"] else ""
    hidden = len(other["rows"]) - len(rows)
    texts = f", without {hidden} texts and topics" if hidden else ""
    head: tuple[str, ...] = ("agent", "at (UTC)", "what", "level", "text", "file")
    shown: list[tuple[str, ...]] = [
        (row["agent"], clock_text(row["t"]), row["what"], row["level"], _said(row), row["file"]) for row in rows
    ]
    return (f"Records of others{texts}{outside}", head, shown)


def _said(row: Json) -> str:
    return f"{row['by']}: {row['text']}" if row["by"] else str(row["text"])


def _problem(row: Json) -> tuple[str, ...]:
    return (row["what"], str(row["count"]), f"{row['file']}:{row['line']}" if row["line"] else row["file"])


def _cut(rows: Sequence[tuple[str, ...]], most: int, width: int) -> list[tuple[str, ...]]:
    kept = [tuple(one_line(cell) for cell in row) for row in rows[:most]]
    if len(rows) > most:
        kept.append((f"and {len(rows) - most} more", *[""] * (width - 1)))
    return kept


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def _percent(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{100 * value:.{digits}f} %"


def _cell(text: str) -> str:
    """A cell of Markdown; text from a log is escaped."""
    escaped = one_line(text)
    for sign in "\\`*_[]<>|#":
        escaped = escaped.replace(sign, f"\\{sign}" if sign not in "<>" else {"<": "&lt;", ">": "&gt;"}[sign])
    return escaped


def _csv(value: object) -> object:
    if isinstance(value, list):
        value = " ".join(map(str, value))
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
