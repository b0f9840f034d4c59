"""`python -m sitl campaign`: see docs/development/campaign.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from sitl.campaign.arguments import parser
from sitl.campaign.fault_catalog import class_of
from sitl.campaign.publication import check_commit
from sitl.campaign.run_sequence import play
from sitl.campaign.schedule import Schedule, check_record, schedule
from sitl.campaign.terminal_report import DONE, show
from sitl.campaign.trial import load
from sitl.harness.console import make_console

INVALID = 2
"""Exit code for options or a record with which nothing can be done."""


def main(arguments: Sequence[str] | None = None) -> int:
    asked = parser().parse_args(arguments)
    console = make_console(json=False)
    if asked.report_only and asked.record is not None:
        return _show(asked.record, asked, console, whole=True)
    try:
        to_do = schedule(asked)
        file = asked.record or Path(default_record(to_do.commit, asked.seed))
        if asked.markdown and asked.seed is not None:
            raise ValueError(f"--seed {asked.seed} cannot be published with --markdown: it was chosen by hand")
        if asked.markdown and asked.note:
            raise ValueError("--note cannot be published with --markdown: the notes cost PHM CPU time")
        if asked.markdown:
            check_commit(to_do.commit)
        if not asked.report_only and not asked.plan:
            check_record(load(file), to_do, file)
    except (ValueError, LookupError) as error:
        return _rejected(error)
    if asked.plan:
        _print_plan(to_do, console)
        return DONE
    whole = True
    if not asked.report_only:
        whole = play(asked, to_do, file, console)
    return _show(file, asked, console, whole=whole)


def _show(file: Path, asked: argparse.Namespace, console: Console, *, whole: bool) -> int:
    try:
        return show(load(file), asked, console, whole=whole)
    except ValueError as error:
        return _rejected(error)


def _rejected(error: Exception) -> int:
    print(f"sitl campaign: {error}", file=sys.stderr)
    return INVALID


def default_record(commit: str, seed: int | None) -> str:
    """Name of the record. A seed that was chosen by hand has a separate record."""
    return f"campaign-{commit[:8]}{'' if seed is None else f'-seed-{seed}'}.jsonl"


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
