"""The rows of `scripts/proof` and how they are shown: on the terminal, as JSON, in docs/reference/recovery.md."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table

from sitl.harness.machine import machine

BEGIN, END = "<!-- proof: begin, written by scripts/proof --markdown -->", "<!-- proof: end -->"
COLUMNS = ("mode", "fault", "alarms", "named", "seen after", "action", "recovered and verified after", "outcome")


@dataclass
class Row:
    """One fault in one mode. Seconds count from the moment the fault was there; None: it did not happen.

    `also` are the units of further faults that were caused together; seconds are then those of the last of all.
    """

    mode: str
    fault: str
    title: str
    unit: str
    also: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)
    actions: list[str] = field(default_factory=list)
    advised: list[str] = field(default_factory=list)
    detected_s: float | None = None
    recovered_s: float | None = None
    given_up_s: float | None = None
    summary: str = ""
    outcome: str = "quiet"
    problems: list[str] = field(default_factory=list)
    beside: list[str] = field(default_factory=list)
    """Alarms about the machine on which all this runs: true, and no consequence of what was injected."""

    @property
    def expected(self) -> list[str]:
        """Where an alarm is due: exactly one at each."""
        return [self.unit, *self.also]

    def alarm(self, unit: str) -> None:
        (self.beside if unit.startswith("host/") else self.alarms).append(unit)

    @property
    def good(self) -> bool:
        return not self.problems

    def cells(self) -> tuple[str, ...]:
        named = ", ".join(sorted(set(self.alarms))) or "-"
        acts = grouped(self.actions) or (f"advised: {grouped(self.advised)}" if self.advised else "none")
        return (
            self.mode,
            self.title,
            str(len(self.alarms)),
            named,
            seconds(self.detected_s),
            acts,
            seconds(self.recovered_s),
            f"{self.outcome}; beside it {', '.join(self.beside)}" if self.beside else self.outcome,
        )


def set_outcome(row: Row, *, healable: bool) -> None:
    """The outcome of a recovery in words, and what about it is not as it must be."""
    if sorted(row.alarms) != sorted(row.expected):
        row.problems.append(f"alarms: {row.alarms or 'none'}, expected one at {' and '.join(row.expected)}")
    if healable:
        row.outcome = "recovered" if row.recovered_s is not None else "not recovered"
        if row.recovered_s is None:
            row.problems.append("was not recovered and verified")
    elif row.recovered_s is not None:
        row.problems.append("counts as recovered, but nothing can have recovered it")
        row.outcome = "recovered"
    elif row.given_up_s is not None:
        row.outcome = f"given up and reported after {row.given_up_s:.0f} s"
    else:
        row.outcome = "reported, left to the operator"
        if row.actions:
            row.problems.append("was acted upon and neither recovered nor given up")


def grouped(words: Iterable[str]) -> str:
    """``start, restart x2`` for start, restart, restart."""
    runs = [(word, len(list(same))) for word, same in groupby(words)]
    return ", ".join(word if count == 1 else f"{word} x{count}" for word, count in runs)


def seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def rich_table(rows: list[Row]) -> Table:
    table = Table(title=f"Recovery on this machine ({machine()})")
    for name in (*COLUMNS, ""):
        table.add_column(name, justify="right" if name.endswith("after") or name == "alarms" else "left")
    for row in rows:
        table.add_row(*row.cells(), "[green]ok[/]" if row.good else f"[red]{'; '.join(row.problems)}[/]")
    return table


def print_row(row: Row, console: Console) -> Row:
    colour, words = ("green", "holds") if row.good else ("red", "; ".join(row.problems))
    actions = ", ".join(row.actions) or "no action"
    console.print(f"  [{colour}]{words}[/]  {row.title}: {row.outcome}, {actions}", highlight=False)
    return row


def print_rows(rows: list[Row], console: Console, *, json: bool) -> int:
    """All rows as a table, or as JSON, and how many hold. Returns the exit code."""
    if json:
        print(as_json(rows))
    else:
        console.print(rich_table(rows))
    bad = sum(not row.good for row in rows)
    console.print(f"{len(rows) - bad} of {len(rows)} rows hold")
    return 1 if bad else 0


def as_json(rows: list[Row]) -> str:
    return json.dumps({"machine": machine(), "rows": [{**asdict(row), "good": row.good} for row in rows]}, indent=2)


def markdown(rows: list[Row], where: str, day: str) -> str:
    """The table with its date and machine."""
    lines = [f"Measured on {day} ({where}), one run of `scripts/proof`.", ""]
    lines += [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        verdict = "" if row.good else f" **does not hold: {'; '.join(row.problems)}**"
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in row.cells())}{verdict} |")
    return "\n".join(lines)


def between_marks(page: str, text: str) -> str:
    """`page` with the text between the two marks replaced. Raises ValueError when it has no marks."""
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page has no marks {BEGIN} and {END}")
    return f"{head}{BEGIN}\n{text}\n{END}{tail}"


def write_markdown(rows: list[Row], page: Path) -> None:
    day = datetime.now(timezone.utc).date().isoformat()
    page.write_text(between_marks(page.read_text("utf-8"), markdown(rows, machine(), day)), "utf-8")
