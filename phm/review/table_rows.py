"""The rows of the report's tables, as text. Pure."""

from __future__ import annotations

from typing import Any

from phm.review.injection_metrics import PAPER
from phm.review.sentences import length
from phm.wire.report import clock_text

Json = dict[str, Any]
MOST_NAMES = 5
OTHERS = "Records of others"
"""Beginning of the title of their table."""


def injection_metrics(table: Json) -> list[tuple[str, ...]]:
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


def agent(row: Json) -> tuple[str, ...]:
    times = (length(row["error_s"]), length(row["warn_s"]), length(row["unknown_s"]))
    name = row["agent"] if row["logged"] else f"{row['agent']} (no log)"
    return (name, str(row["faults"]), *times, _percent(row["uptime"], 2), length(row["armed_s"]))


def fault(row: Json) -> tuple[str, ...]:
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


def check(row: Json) -> tuple[str, ...]:
    high = length(row["mtbf_high_s"]) if row["mtbf_high_s"] else "more"
    mean = length(row["mtbf_s"]) if row["faults"] else "no fault"
    return (
        row["check"],
        str(row["faults"]),
        f"{mean} ({length(row['mtbf_low_s'])} to {high})",
        _seconds(row["mttr_s"]),
    )


def available(row: Json) -> tuple[str, ...]:
    name = row["kind"] if row["kind"] == "agent" else f"{row['kind']} {row['name']}"
    return (row["agent"], name, _percent(row["availability"], 3), length(row["error_s"]), length(row["unknown_s"]))


def clock(row: Json) -> tuple[str, ...]:
    offset = "unknown" if row["offset_s"] is None else f"{row['offset_s']:+.2f} s"
    offset += "" if row["applied"] or row["offset_s"] is None else " (within its error, not applied)"
    steps = f"; its UTC jumped {len(row['steps'])} times" if row["steps"] else ""
    return (row["agent"], row["boot_id"], offset, _seconds(row["error_s"]), (row["by"] or "its own clock") + steps)


def external_clock(row: Json) -> tuple[str, ...]:
    none = "had no time" if row["applied"] else "unknown"
    offset = none if row["offset_s"] is None else f"{row['offset_s']:+.2f} s"
    by = f"{row['lines']} {row['by']}" if row["applied"] else row["by"]
    return (row["file"], "-", offset, _seconds(row["error_s"]), by)


def others(other: Json, most: int) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
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
    return (f"{OTHERS}{texts}{outside}", head, shown)


def _said(row: Json) -> str:
    return f"{row['by']}: {row['text']}" if row["by"] else str(row["text"])


def problem(row: Json) -> tuple[str, ...]:
    return (row["what"], str(row["count"]), f"{row['file']}:{row['line']}" if row["line"] else row["file"])


def flight(row: Json) -> tuple[str, ...]:
    """The number is that of `--flight`."""
    names = row["agents"][:MOST_NAMES]
    more = len(row["agents"]) - len(names)
    said = ", ".join(names) + (f" and {more} more" if more else "")
    return (str(row["number"]), clock_text(row["begin"]), length(row["duration_s"]), said)


def unknown(row: Json) -> tuple[str, ...]:
    return (row["agent"], row["unit"], length(row["unknown_s"]), length(row["blocked_s"]))


def phm(row: Json) -> tuple[str, ...]:
    """What PHM itself did and cost on one agent."""
    cost = (
        _known(row["cpu_percent"], "{:.1f} %"),
        _known(row["memory_bytes"], "{:.0f} MB", 1e6),
        _known(row["sent_bytes"], "{:.1f} kB", 1e3),
        _known(row["text_bytes"], "{:.0f} bytes"),
    )
    times = (_known(row["report_mean_s"], "{:.3f} s"), _known(row["report_longest_s"], "{:.3f} s"))
    ran = _known(row["uptime"], "{:.2f} %", 0.01)
    return (row["agent"], ran, str(row["restarts"]), str(row["reloads"]), str(row["reports"]), *times, *cost)


def cut(document: Json) -> list[tuple[str, ...]]:
    """What is not in the report: lines that the logs and the ground's records lack, and what is beyond a limit."""
    found = []
    grounds = [{"agent": "ground", **row} for row in document["files"]["grounds"]]
    for row in [*document["agents"], *grounds]:
        lacking = (
            ("lines that PHM could not write", row["lost_lines"]),
            ("lines that are missing in the logs", row["missing_lines"]),
            ("changes, faults and marks beyond the limits of a run", row["left_out"]),
        )
        found += [(row["agent"], what, str(count)) for what, count in lacking if count]
    return found + [(row["agent"] or "all", row["what"], str(row["count"])) for row in document["cut"]]


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def _percent(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{100 * value:.{digits}f} %"


def _known(value: float | None, form: str, unit: float = 1.0) -> str:
    return "not known" if value is None else form.format(value / unit)
