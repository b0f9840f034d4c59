"""Shows the result of a campaign in the terminal and writes the requested reports."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from sitl.campaign import table
from sitl.campaign.groups import groups
from sitl.campaign.progress import left
from sitl.campaign.publication import PAGE, README, RECORD, publish
from sitl.campaign.report import as_html, as_json, description
from sitl.campaign.sections import problems
from sitl.campaign.targets import short
from sitl.campaign.trial import Trial

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
        ("beside the paper's Table 2", table.head("metric", found, "paper, Table 2"), table.paper_comparison(found)),
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
    missing = left(trials)
    incomplete = bool(missing) or not whole
    if asked.markdown and incomplete and not asked.incomplete:
        console.print(
            f"not written: {RECORD}, {PAGE}, {README}: the campaign is incomplete. --incomplete writes them with a note",
            highlight=False,
        )
    elif asked.markdown:
        publish(trials)
        console.print(f"written: {RECORD}, {PAGE}, {README}", highlight=False)
    if incomplete:
        console.print(f"{missing or 'some'} of the planned trials are missing; call again to go on", highlight=False)
        return NOT_DONE
    return SHORT if short(found) else DONE


def _rich(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    made = Table(title=title)
    for name in head:
        made.add_column(name)
    for row in rows:
        made.add_row(*(f"[red]{cell}[/]" if cell.endswith("NOT met") else cell for cell in row))
    return made
