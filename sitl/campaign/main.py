"""`python -m sitl campaign`: see docs/development/campaign.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from sitl.campaign import table
from sitl.campaign.arguments import parser
from sitl.campaign.fault_catalog import class_of
from sitl.campaign.metrics import figures
from sitl.campaign.play import play
from sitl.campaign.report import Setting, as_html, as_json, as_markdown, between_marks
from sitl.campaign.schedule import Schedule, check_record, schedule
from sitl.campaign.targets import short
from sitl.campaign.trial import Trial, load
from sitl.harness.compose_stack import ROOT
from sitl.harness.console import make_console

DONE, SHORT, NOT_DONE = 0, 1, 75
"""Exit codes: every aim is met; some are not; stopped before the end (EX_TEMPFAIL): call again to continue."""


def main(arguments: Sequence[str] | None = None) -> int:
    asked = parser().parse_args(arguments)
    console = make_console(json=False)
    try:
        to_do = schedule(asked)
        file = asked.record or Path(f"campaign-{to_do.commit[:8]}.jsonl")
        if not asked.report_only and not asked.plan:
            check_record(load(file), to_do, file)
    except (ValueError, LookupError) as error:
        print(f"sitl campaign: {error}", file=sys.stderr)
        return 2
    if asked.plan:
        _print_plan(to_do, console)
        return DONE
    whole = True
    if not asked.report_only:
        whole = play(asked, to_do, file, console)
    return _report(asked, load(file), to_do.planned, console, whole=whole)


def _report(asked: argparse.Namespace, trials: Sequence[Trial], planned: int, console: Console, *, whole: bool) -> int:
    if not trials:
        console.print("no trial is made yet; call again to continue", highlight=False)
        return NOT_DONE
    known = trials[-1].setting
    setting = Setting(known["seed"], known["machine"], known["day"], known["autopilot"], known["interval_s"], planned)
    found = figures(trials)
    console.print(
        _rich(f"PHM on {found.agents} agents ({setting.words})", table.TABLE2, table.table2(found, setting.interval_s))
    )
    console.print(_rich("further figures", ("figure", "value"), table.beyond(found)))
    for words in table.short(found.judged):
        console.print(f"- {words}", markup=False, highlight=False)
    for path, make in ((asked.json, as_json), (asked.html, as_html)):
        if path is not None:
            path.write_text(make(trials, setting), "utf-8")
            console.print(f"written: {path}", highlight=False)
    if asked.markdown:
        page = ROOT / "docs" / "development" / "results.md"
        page.write_text(between_marks(page.read_text("utf-8"), as_markdown(trials, setting)), "utf-8")
    if not whole or found.trials < planned:
        console.print(f"{found.trials} of {planned} trials are made; call again to continue", highlight=False)
        return NOT_DONE
    return SHORT if short(found) else DONE


def _rich(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    made = Table(title=title)
    for name in head:
        made.add_column(name)
    for row in rows:
        made.add_row(*(f"[red]{cell}[/]" if cell == "NOT met" else cell for cell in row))
    return made


def _print_plan(to_do: Schedule, console: Console) -> None:
    """The trials of each seed, how often each fault is injected in all, and what is left out."""
    for index, trials in enumerate(to_do.plans):
        console.print(f"seed {index + 1} of {len(to_do.seeds)}: {to_do.seeds[index]}", highlight=False)
        for each in trials:
            what = ", ".join(f"{draw.fault} on A{draw.agent:02d}" for draw in each.draws)
            console.print(f"{each.number:4}  {each.kind:8}  {what}", highlight=False, soft_wrap=True)
    times, every = to_do.counts, [each for trials in to_do.plans for each in trials]
    together = sum(each.together > 1 for each in every)
    console.print(
        f"{len(every)} trials, {together} with several faults on one agent; {times.total()} faults of {len(to_do.faults)} "
        "classes:",
        highlight=False,
        soft_wrap=True,
    )
    for name, fault in sorted(to_do.faults.items()):
        console.print(f"{times[name]:4}  {class_of(fault).kind:10}  {name}", highlight=False, soft_wrap=True)
    for name, why in sorted(to_do.excluded.items()):
        console.print(f"   -  {name}: {why}", markup=False, highlight=False, soft_wrap=True)
