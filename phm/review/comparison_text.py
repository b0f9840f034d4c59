"""Writes a comparison as sentences and tables. Pure."""

from __future__ import annotations

from collections import Counter
from typing import Any

from phm.review.sentences import length
from phm.review.tables import Table

Json = dict[str, Any]
HEAD = (
    "verdict",
    "",
    "faults A",
    "faults B",
    "per hour A",
    "per hour B",
    "MTTR A",
    "MTTR B",
    "probability",
    "may be random",
)


def sentences(comparison: Json) -> list[str]:
    """What was compared, and which changes are statistically significant."""
    lines = [_about(name, comparison[name.lower()]) for name in ("A", "B")]
    real = Counter(row["verdict"] for row in comparison["faults"] if not row["chance"])
    rest = sum(row["chance"] for row in comparison["faults"])
    changed = ", ".join(f"{count} {verdict}" for verdict, count in real.items()) or "nothing"
    lines.append(f"Statistically significant: {changed}; {rest} other differences of faults may be random.")
    return lines


def tables(comparison: Json) -> list[Table]:
    """The tables of checks, and of faults by unit and condition."""
    found: list[Table] = []
    for key, kind, title in (("checks", "check", "Checks"), ("faults", "fault", "Faults")):
        head = (HEAD[0], kind, *HEAD[2:])
        found.append((title, head, [_row(row, kind) for row in comparison[key]]))
    return found


def _about(name: str, about: Json) -> str:
    version = f", PHM {', '.join(about['versions'])}" if about["versions"] else ""
    window = about["window"]
    flight = f"flight {window['flight']}, " if window["flight"] else ""
    counts = f"{about['agents']} agents{version}, {about['faults']} faults"
    return f"{name}: {flight}{length(about['lasted_s'])}, {counts} in {length(about['ran_s'])} of PHM running."


def _row(row: Json, kind: str) -> tuple[str, ...]:
    pairs = [*row["faults"], *row["per_hour"], *row["mttr_s"]]
    shown = ["-" if value is None else f"{value:g}" for value in pairs]
    probability = "-" if row["corrected"] is None else f"{row['corrected']:.3g}"
    return (row["verdict"], row[kind], *shown, probability, "yes" if row["chance"] else "no")
