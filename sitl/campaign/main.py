"""`python -m sitl campaign`: see docs/development/campaign.md."""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from sitl.campaign import table
from sitl.campaign.fault_catalog import CHANGES, chosen, class_of
from sitl.campaign.metrics import figures
from sitl.campaign.plan import TrialPlan, plan
from sitl.campaign.report import Setting, as_html, as_json, as_markdown, between_marks
from sitl.campaign.run import NotOk, Runner
from sitl.campaign.targets import short
from sitl.campaign.trial import NOMINAL, OFF, TRIAL, Trial, append, load
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.harness.compose_stack import ROOT
from sitl.harness.console import make_console
from sitl.harness.machine import machine
from sitl.swarm import startup
from sitl.swarm.options import DEFAULT_NAME, Options
from sitl.swarm.swarm import Swarm

DONE, SHORT, NOT_DONE = 0, 1, 75
"""Exit codes: every aim is met; some are not; stopped before the end (EX_TEMPFAIL): call again to go on."""
GUESS_S = 45.0
"""Of a trial, before one was made."""


def parser() -> argparse.ArgumentParser:
    words = argparse.ArgumentParser(prog="python -m sitl campaign", description=__doc__)
    words.add_argument("--agents", type=int, default=8, metavar="N", help="agents of the swarm (8)")
    words.add_argument("--trials", type=int, default=20, metavar="N", help="trials, single and compound faults (20)")
    words.add_argument("--seed", type=int, default=1, metavar="S", help="what is injected where (1)")
    words.add_argument("--only", nargs="+", default=(), metavar="FAULT", help="draw from these faults alone")
    words.add_argument("--nominal", type=float, default=60.0, metavar="S", help="seconds with nothing injected (60)")
    words.add_argument("--interval", type=float, default=20.0, metavar="S", help="PHM's reactivation interval (20)")
    words.add_argument("--autopilot", choices=("sim", "ardupilot", "px4"), default="sim", help="(sim)")
    words.add_argument("--autopilot-path", default="", metavar="FILE", help="of a real autopilot, as in `up`")
    words.add_argument("--autopilot-image", default="", metavar="IMAGE", help="of a real autopilot, as in `up`")
    words.add_argument("--name", default=DEFAULT_NAME, help=f"of the swarm ({DEFAULT_NAME}); one that is up is used")
    words.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help="trials, one a line; a campaign goes on from there (campaign-SEED.jsonl)",
    )
    words.add_argument("--json", type=Path, metavar="FILE", help="write the report with everything in it")
    words.add_argument("--html", type=Path, metavar="FILE", help="write the report as a page")
    words.add_argument("--markdown", action="store_true", help="write the result into docs/development/results.md")
    words.add_argument("--report-only", action="store_true", help="only make the reports from the record")
    words.add_argument(
        "--stop-after", type=float, metavar="S", help="begin no trial after so many seconds; call again to go on"
    )
    words.add_argument("--keep", action="store_true", help="leave the swarm up at the end")
    words.add_argument("--no-build", action="store_true", help="take the images as they are")
    words.add_argument("--plan", action="store_true", help="only print what would be injected")
    return words


def main(arguments: Sequence[str] | None = None) -> int:
    asked = parser().parse_args(arguments)
    console = make_console(json=False)
    file = asked.record or Path(f"campaign-{asked.seed}.jsonl")
    try:
        faults = chosen(all_faults(), asked.only, asked.agents, air=True)
        trials = plan(asked.seed, asked.agents, asked.trials, [class_of(fault) for fault in faults.values()])
        done = load(file)
        setting = _setting(asked, faults)
        if not asked.report_only:
            _same(done, setting, file)
    except ValueError as error:
        print(f"sitl campaign: {error}", file=sys.stderr)
        return 2
    if asked.plan:
        _print_plan(trials, console)
        return DONE
    whole = True
    if not asked.report_only:
        whole = _play(asked, faults, trials, file, setting, console)
    return _report(asked, load(file), len(trials), console, whole=whole)


def _setting(asked: argparse.Namespace, faults: dict[str, Fault]) -> dict[str, Any]:
    names = ",".join(sorted(faults))
    return {
        "seed": asked.seed,
        "agents": asked.agents,
        "autopilot": asked.autopilot,
        "interval_s": asked.interval,
        "faults": hashlib.sha256(names.encode()).hexdigest()[:12],
        "machine": machine(),
        "day": datetime.now(timezone.utc).date().isoformat(),
    }


def _same(done: Sequence[Trial], setting: dict[str, Any], file: Path) -> None:
    """Raise ValueError with the difference when the record is of another campaign."""
    for trial in done:
        other = {
            key
            for key in ("seed", "agents", "autopilot", "interval_s", "faults")
            if trial.setting.get(key) != setting[key]
        }
        if other:
            raise ValueError(
                f"{file} is the record of another campaign, with other {', '.join(sorted(other))}: name another with --record, "
                "or call with what it was begun with"
            )


def _swarm(asked: argparse.Namespace, console: Console) -> tuple[Swarm, bool]:
    """The running swarm of this name, or a new one; and whether the campaign must take it down."""
    try:
        swarm = Swarm.load(asked.name)
    except LookupError:
        options = Options(
            agents=asked.agents,
            name=asked.name,
            interval_s=asked.interval,
            autopilot=asked.autopilot,
            autopilot_path=asked.autopilot_path,
            autopilot_image=asked.autopilot_image,
            seed=asked.seed,
            changes=CHANGES,
            build=not asked.no_build,
        )
        swarm = Swarm(options)
        console.print(f"starting {asked.agents} agents")
        startup.up(swarm, lambda words: console.print(words, highlight=False))
        return swarm, True
    if len(swarm.agents) != asked.agents:
        raise LookupError(
            f"the swarm {asked.name} that is up has {len(swarm.agents)} agents, not {asked.agents}: take it down "
            f"(`python -m sitl down --name {asked.name}`) or give the campaign another --name"
        )
    missing = [key for key in CHANGES if key not in swarm.options.changes]
    if missing:
        raise LookupError(
            f"the swarm {asked.name} that is up was not made for a campaign (its budget of repairs is too small): take it down, "
            "and let the campaign start its own"
        )
    return swarm, False


def _play(
    asked: argparse.Namespace,
    faults: dict[str, Fault],
    trials: Sequence[TrialPlan],
    file: Path,
    setting: dict[str, Any],
    console: Console,
) -> bool:
    """Run the trials that are still missing; return whether all are made."""
    began, ours = time.monotonic(), False
    swarm = None
    try:
        swarm, ours = _swarm(asked, console)
        runner = Runner(swarm, all_faults(), setting, lambda words: console.print(words, highlight=False))
        try:
            runner.start()
            return _all(runner, asked, trials, file, console, began)
        finally:
            runner.stop()
    except KeyboardInterrupt:
        console.print("interrupted; call again to go on from here", highlight=False)
        return False
    except (LookupError, RuntimeError) as error:
        console.print(f"[red]the campaign has stopped:[/] {error}", highlight=False)
        if isinstance(error, NotOk):
            console.print("call again to go on from here", highlight=False)
        return False
    finally:
        if ours and swarm is not None and not asked.keep:
            swarm.down()


def _all(
    runner: Runner, asked: argparse.Namespace, trials: Sequence[TrialPlan], file: Path, console: Console, began: float
) -> bool:
    def late() -> bool:
        return asked.stop_after is not None and time.monotonic() - began > asked.stop_after

    done = {(trial.kind, trial.number): trial for trial in load(file)}
    runs = ((NOMINAL, partial(runner.nominal, asked.nominal)), (OFF, partial(runner.off, asked.seed)))
    for kind, make in runs:
        if late():
            return False
        if (kind, 0) not in done:
            console.print(f"[bold]{kind}[/]", highlight=False)
            append(file, make())
    took = [trial.seconds for (kind, _), trial in done.items() if kind == TRIAL]
    for place, each in enumerate(trials):
        if (TRIAL, each.number) in done:
            continue
        if late():
            return False
        left_s = (len(trials) - place) * (sum(took) / len(took) if took else GUESS_S)
        what = ", ".join(f"{draw.fault} on A{draw.agent:02d}" for draw in each.draws)
        console.print(
            f"[bold]trial {each.number} of {len(trials)}[/]  {what}  [dim]({left_s / 60:.0f} min left)[/]",
            highlight=False,
        )
        trial = runner.trial(each)
        append(file, trial)
        took.append(trial.seconds)
        for row in table.trials(figures([trial]).judged):
            _, agent, title, seen, reported, healed, by, alarms, remarks = row
            colour = "red" if remarks else "green"
            console.print(
                f"  [{colour}]{agent} {title}[/]: detected {seen} s, reported {reported} s, healed {healed} s {by}; {alarms} alarms {remarks}",
                highlight=False,
            )
    return True


def _report(asked: argparse.Namespace, trials: Sequence[Trial], planned: int, console: Console, *, whole: bool) -> int:
    known = trials[-1].setting if trials else _setting(asked, {})
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
        console.print(f"{found.trials} of {planned} trials are made; call again to go on", highlight=False)
        return NOT_DONE
    return SHORT if short(found) else DONE


def _rich(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    made = Table(title=title)
    for name in head:
        made.add_column(name)
    for row in rows:
        made.add_row(*(f"[red]{cell}[/]" if cell == "NOT met" else cell for cell in row))
    return made


def _print_plan(trials: Sequence[TrialPlan], console: Console) -> None:
    for each in trials:
        what = ", ".join(f"{draw.fault} on A{draw.agent:02d}" for draw in each.draws)
        console.print(f"{each.number:4}  {each.kind:8}  {what}", highlight=False)
