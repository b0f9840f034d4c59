"""The command `scripts/soak`."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from docker.errors import DockerException
from rich.console import Console
from rich.table import Table

from sitl.campaign import seeds
from sitl.harness.machine import machine
from sitl.soak import publication, report
from sitl.soak.runner import PROFILE, Plan, Soak, load, observed_s
from sitl.soak.sample import load as load_samples
from sitl.swarm import startup
from sitl.swarm.options import Options
from sitl.swarm.swarm import Swarm

COMPLETE, INVALID, STOPPED = 0, 2, 75
NAME = "phm-soak"
TRIALS, SAMPLES, SETTING, DOCUMENT, PAGE, LOGS = (
    "runs.jsonl",
    "samples.jsonl",
    "setting.json",
    "soak.json",
    "soak.html",
    "logs",
)


def parser() -> argparse.ArgumentParser:
    words = argparse.ArgumentParser(
        prog="scripts/soak",
        description="Run a swarm for hours with rare faults, and show what grows and how many false alarms there are.",
        epilog="Ctrl-C writes what is known; the same command continues. See docs/development/soak.md.",
    )
    words.add_argument("hours", nargs="?", type=float, metavar="HOURS", help="to observe (2)")
    words.add_argument("--minutes", type=float, metavar="M", help="instead of HOURS, for a try")
    words.add_argument("--agents", type=int, default=8, metavar="N", help="of the swarm (8)")
    words.add_argument(
        "--every",
        type=float,
        metavar="M",
        help="minutes between two faults (10; less in the tries of below half an hour)",
    )
    words.add_argument(
        "--period", type=float, metavar="S", help="seconds between two samples (10; 5 below half an hour)"
    )
    words.add_argument("--seed", type=int, metavar="S", help="of the faults (from the commit)")
    words.add_argument("--out", type=Path, default=Path("soak"), metavar="DIR", help="folder of the results (soak)")
    words.add_argument("--name", default=NAME, help=f"of the swarm ({NAME}); one that is up is used")
    words.add_argument(
        "--keep", action="store_true", help="leave the swarm up; the same command continues with the same PHM"
    )
    words.add_argument("--no-build", action="store_true", help="use the images that exist")
    words.add_argument("--report-only", action="store_true", help="only make the reports from the record")
    words.add_argument(
        "--markdown",
        action="store_true",
        help=f"publish: write the record and its figures into {publication.PAGE.parent}",
    )
    words.add_argument("--json", action="store_true", help="print the figures as JSON")
    return words


def main(arguments: Sequence[str] | None = None) -> int:
    """0: all of it was observed; 2: invalid options; 75: it was stopped before, call again to continue."""
    console = Console(stderr=True)
    words = parser()
    asked = words.parse_args(arguments)
    try:
        plan, setting = _begun(asked)
    except (ValueError, LookupError, OSError) as error:
        console.print(f"scripts/soak: {error}", highlight=False, soft_wrap=True, style="red")
        return INVALID
    if not asked.report_only:
        # A service manager or a closed terminal must not leave a swarm behind.
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler)
        _play(asked, plan, console)
    found = _reported(asked.out, setting)
    _print(found, asked.out, as_json=asked.json)
    if asked.markdown:
        try:
            samples, trials = load_samples(_recorded(asked.out, SAMPLES)), load(_recorded(asked.out, TRIALS))
            publication.publish(samples, trials, setting)
        except (ValueError, OSError) as error:
            console.print(f"scripts/soak: {error}", highlight=False, soft_wrap=True, style="red")
            return INVALID
    return COMPLETE if found["observed_s"] >= plan.seconds - 2 * plan.period_s else STOPPED


def _begun(asked: argparse.Namespace) -> tuple[Plan, dict[str, Any]]:
    """What to do. The setting of the record that is continued must be the same. ValueError says what is wrong."""
    if asked.report_only:
        setting = _setting(asked.out)
        return Plan(setting["seconds"], setting["every_s"], setting["period_s"], setting["seed"]), setting
    if asked.hours is not None and asked.minutes is not None:
        raise ValueError("give HOURS or --minutes, not both")
    seconds = 60 * asked.minutes if asked.minutes is not None else 3600 * (2.0 if asked.hours is None else asked.hours)
    short = seconds < 1800
    every_s = 60 * asked.every if asked.every is not None else (seconds / 3 if short else 600.0)
    period_s = asked.period if asked.period is not None else (5.0 if short else 10.0)
    if not 60 <= seconds <= 7 * 86400:
        raise ValueError(f"{seconds:g} s to observe: allowed are 1 minute to 7 days")
    if not 10 <= every_s <= seconds:
        raise ValueError(f"--every {every_s / 60:g}: allowed are 10 s to all the time that is observed")
    if not 1 <= period_s <= 600:
        raise ValueError(f"--period {period_s:g}: allowed are 1 to 600 s")
    commit = seeds.checked_out()
    setting = {
        "seconds": seconds,
        "every_s": every_s,
        "period_s": period_s,
        "agents": asked.agents,
        "seed": seeds.seed_of(commit, 0) if asked.seed is None else asked.seed,
        "commit": commit,
        "machine": machine(),
        "profile": PROFILE.name,
    }
    Swarm(Options(agents=asked.agents, name=asked.name))  # ValueError for what it cannot be
    asked.out.mkdir(parents=True, exist_ok=True)
    if (asked.out / SETTING).exists():
        other = [key for key, value in setting.items() if _setting(asked.out).get(key) != value]
        if other:
            raise ValueError(
                f"{asked.out} is the record of another soak (other {', '.join(other)}): give another folder with --out, or repeat "
                "the options with which it was begun"
            )
    else:
        (asked.out / SETTING).write_text(json.dumps(setting, indent=2) + "\n", "utf-8")
    return Plan(seconds, every_s, period_s, int(str(setting["seed"]))), setting


def _setting(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / SETTING).read_text("utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{folder} has no record of a soak: name its folder with --out") from None
    if not isinstance(found, dict):
        raise ValueError(f"{folder / SETTING} is not the setting of a soak")
    return found


def _play(asked: argparse.Namespace, plan: Plan, console: Console) -> None:
    """Observe what is still missing."""

    def progress(words: str) -> None:
        console.print(words, highlight=False, soft_wrap=True, markup=False)

    if observed_s(load(asked.out / TRIALS)) >= plan.seconds - plan.period_s:
        progress(f"{asked.out} is complete")
        return
    swarm, ours = None, False
    try:
        options = Options(
            agents=asked.agents,
            name=asked.name,
            seed=plan.seed % 2**31,
            changes=PROFILE.changes,
            profile=PROFILE.name,
            build=not asked.no_build,
        )
        swarm, ours = startup.running_or_started(options, progress)
        Soak(swarm, plan, asked.out / TRIALS, asked.out / SAMPLES, progress).run()
    except KeyboardInterrupt:
        progress("interrupted; the same command continues")
    except (LookupError, RuntimeError, DockerException) as error:
        progress(f"the soak has stopped: {error}")
    finally:
        if swarm is not None:
            _keep_logs(swarm, asked.out / LOGS)
            if ours and not asked.keep:
                swarm.down()


def _keep_logs(swarm: Swarm, folder: Path) -> None:
    """Copy PHM's logs, for `phm report`; those of an earlier session stay beside them."""
    if (swarm.folder / LOGS).is_dir():
        shutil.copytree(swarm.folder / LOGS, folder / str(os.getpid()), dirs_exist_ok=True)


def _recorded(folder: Path, name: str) -> Path:
    """A file of the record; of a published one, which is compressed, too."""
    packed = folder / f"{name}.gz"
    return packed if packed.exists() and not (folder / name).exists() else folder / name


def _reported(folder: Path, setting: dict[str, Any]) -> dict[str, Any]:
    """Write document and page."""
    samples, trials = load_samples(_recorded(folder, SAMPLES)), load(_recorded(folder, TRIALS))
    found = report.document(samples, trials, setting)
    (folder / DOCUMENT).write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", "utf-8")
    (folder / PAGE).write_text(report.page(found, samples, trials), "utf-8")
    return found


def _print(found: dict[str, Any], folder: Path, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(found, indent=1, allow_nan=False) + "\n")
        return
    console = Console()
    table = Table(title="PHM soak")
    for head in report.HEAD:
        table.add_column(head)
    for row in report.table(found):
        table.add_row(*row)
    console.print(table)
    for sentence in [*report.sentences(found), *found["alarms"]["listed"]]:
        console.print(sentence, highlight=False, soft_wrap=True, markup=False)
    console.print(f"{folder / PAGE}, {folder / DOCUMENT}", highlight=False, soft_wrap=True)
