"""Shows the result of a campaign in the terminal and writes the requested reports."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from sitl.campaign import table
from sitl.campaign.groups import groups
from sitl.campaign.publish import PAGE, README, RECORD, publish
from sitl.campaign.report import as_html, as_json, description
from sitl.campaign.sections import problems
from sitl.campaign.targets import short
from sitl.campaign.trial import TRIAL, Trial

DONE, SHORT, NOT_DONE = 0, 1, 75
"""Exit codes: every target is met; some are not; stopped before the end (EX_TEMPFAIL): call again to go on."""


def show(trials: Sequence[Trial], asked: argparse.Namespace, console: Console, *, whole: bool) -> int:
    """Show and write what `asked` wants; return the exit code. `whole`: the caller has no trial left to run."""
    if not trials:
        console.print("the record has no trial yet, so no report was written", highlight=False)
        return NOT_DONE
    found = groups(trials)
    console.print(description(found), markup=False, highlight=False)
    for title, head, rows in (
        ("beside the paper's Table 2", table.head("metric", found, "paper, Table 2"), table.table2(found)),
        ("what ended the faults", table.head("ended by", found), table.endings(found)),
        ("confirmed from outside", table.head("number of faults", found), table.outside(found)),
    ):
        console.print(_rich(title, head, rows))
    for sentence in problems(found):
        console.print(f"- {sentence}", markup=False, highlight=False)
    for path, make in ((asked.json, as_json), (asked.html, as_html)):
        if path is not None:
            path.write_text(make(trials), "utf-8")
            console.print(f"written: {path}", highlight=False)
    if asked.markdown:
        publish(trials)
        console.print(f"written: {RECORD}, {PAGE}, {README}", highlight=False)
    missing = left(trials)
    if missing or not whole:
        console.print(f"{missing or 'some'} of the planned trials are missing; call again to go on", highlight=False)
        return NOT_DONE
    return SHORT if short(found) else DONE


def left(trials: Sequence[Trial]) -> int:
    """Planned trials that are not in the record, those of seeds that were not begun included."""
    planned = {trial.campaign: int(trial.setting.get("planned", 0)) for trial in trials}
    seeds = {trial.campaign[:2]: int(trial.setting.get("seeds", 1)) for trial in trials}
    made = [trial.campaign for trial in trials if trial.kind == TRIAL]
    missing = sum(max(0, number - made.count(campaign)) for campaign, number in planned.items())
    for kind, wanted in seeds.items():
        begun = [number for campaign, number in planned.items() if campaign[:2] == kind]
        missing += max(0, wanted - len(begun)) * max(begun)
    return missing


def _rich(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    made = Table(title=title)
    for name in head:
        made.add_column(name)
    for row in rows:
        made.add_row(*(f"[red]{cell}[/]" if cell.endswith("NOT met") else cell for cell in row))
    return made
