"""Runs what is missing of a campaign, seed after seed, on one swarm."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from docker.errors import DockerException
from rich.console import Console

from sitl.campaign import fault_rows
from sitl.campaign.busy import BusyLoad
from sitl.campaign.differences import of_swarm
from sitl.campaign.kept_logs import folder_of, keep
from sitl.campaign.pacing import first_ready
from sitl.campaign.plan import TrialPlan
from sitl.campaign.runner import NotOk, Runner
from sitl.campaign.schedule import Schedule
from sitl.campaign.scoring import judge
from sitl.campaign.trial import BUSY, NOMINAL, OFF, TRIAL, Trial, append, load
from sitl.faults import _inject_note, all_faults
from sitl.faults.base import Agent, Fault
from sitl.swarm import engine, startup
from sitl.swarm.options import Options

GUESS_S = 70.0
"""Of a trial, before one was made."""


def play(asked: argparse.Namespace, to_do: Schedule, file: Path, console: Console) -> bool:
    """Run the trials that are still missing; return whether all are made."""
    swarm, ours = None, False

    def progress(words: str) -> None:
        console.print(words, highlight=False, soft_wrap=True)

    def note(fault: Fault, agent: Agent) -> None:
        if why_not := _inject_note.write(fault, agent):
            progress(f"  A{agent.number:02d}: PHM's log has no note of {fault.name}: {why_not}")

    try:
        swarm, ours = startup.running_or_started(_options(asked, to_do), progress)
        if others := engine.others(swarm.docker, swarm.name):
            progress(f"[yellow]other containers run, which take CPU time from this campaign:[/] {', '.join(others)}")
        busy = BusyLoad(swarm) if to_do.load == BUSY else None
        runner = Runner(swarm, all_faults(), to_do.profile, progress, busy, note if asked.note else None)
        if not ours:
            runner.resume(each for each in load(file) if each.campaign[0] == to_do.profile.name)
        try:
            runner.start()
            return _Sequence(runner, to_do, file, progress, asked).run()
        finally:
            runner.stop()
    except KeyboardInterrupt:
        progress("interrupted; call again to continue from here")
        return False
    except (LookupError, RuntimeError, DockerException) as error:
        progress(f"[red]the campaign has stopped:[/] {error}")
        if isinstance(error, NotOk):
            progress("call again to continue from here")
        return False
    finally:
        if ours and swarm is not None and not asked.keep:
            swarm.down()


def _options(asked: argparse.Namespace, to_do: Schedule) -> Options:
    """Of the swarm of this campaign."""
    return Options(
        agents=asked.agents,
        name=asked.name,
        interval_s=asked.interval,
        autopilot=asked.autopilot,
        autopilot_path=asked.autopilot_path,
        autopilot_image=asked.autopilot_image,
        seed=to_do.seeds[0],
        changes=to_do.profile.changes,
        profile=to_do.profile.name,
        build=not asked.no_build,
    )


class _Sequence:
    """All runs of all seeds that the record does not have yet."""

    def __init__(
        self, runner: Runner, to_do: Schedule, file: Path, progress: Callable[[str], None], asked: argparse.Namespace
    ) -> None:
        self._runner, self._to_do, self._file, self._progress, self._asked = runner, to_do, file, progress, asked
        self._began = time.monotonic()
        done = [each for each in load(file) if each.campaign[:2] == (to_do.profile.name, to_do.load)]
        self._done = {(each.setting["seed"], each.kind, each.number) for each in done}
        self._took = [each.seconds for each in done if each.kind == TRIAL]
        runner.on_end = self._made

    def run(self) -> bool:
        """Whether all are made; no run begins after `--stop-after`."""
        differences = of_swarm(self._runner.swarm)
        for index, trials in enumerate(self._to_do.plans):
            self._runner.setting = {**self._to_do.setting(index), "differences": differences}
            if not all(self._ensure(index, *run) for run in self._runs(index, trials)):
                return False
        return True

    def _runs(self, index: int, trials: tuple[TrialPlan, ...]) -> Iterator[tuple[str, int, str, Callable[[], Trial]]]:
        """Kind, number, words and function of each run of a seed that is to be made."""
        runner, seed = self._runner, self._to_do.seeds[index]
        yield NOMINAL, 0, "nothing is injected", partial(runner.nominal, self._asked.nominal)
        yield OFF, 0, "recovery is off", partial(runner.off, seed)
        while waiting := [each for each in trials if (seed, TRIAL, each.number) not in self._done]:
            trial = first_ready(waiting, lambda each: runner.ready_at(each.draws), time.monotonic())
            yield TRIAL, trial.number, _words(trial), partial(runner.trial, trial)

    def _ensure(self, index: int, kind: str, number: int, words: str, make: Callable[[], Trial]) -> bool:
        seed, limit = self._to_do.seeds[index], self._asked.stop_after
        if (seed, kind, number) in self._done:
            return True
        if limit is not None and time.monotonic() - self._began > limit:
            return False
        which = f"trial {number} of {len(self._to_do.plans[index])}" if kind == TRIAL else kind
        self._progress(
            f"[bold]seed {index + 1} of {len(self._to_do.seeds)}, {which}[/]  {words}  [dim]({self._left_min():.0f} min left)[/]"
        )
        try:
            make()
        except BaseException as error:
            if (seed, kind, number) not in self._done:
                append(self._file, self._runner.aborted(kind, number, error))
            raise
        return True

    def _made(self, trial: Trial) -> None:
        """Record a complete run immediately: what follows it may fail."""
        append(self._file, trial)
        self._done.add((trial.setting["seed"], trial.kind, trial.number))
        if trial.kind == TRIAL:
            self._took.append(trial.seconds)
            self._show(trial)
        if kept := keep(folder_of(self._file), judge(trial), self._runner.watch.events):
            self._progress(f"  PHM's logs: {kept}")

    def _left_min(self) -> float:
        made = len([each for each in self._done if each[1] == TRIAL])
        each_s = sum(self._took) / len(self._took) if self._took else GUESS_S
        return max(0, self._to_do.planned - made) * each_s / 60

    def _show(self, trial: Trial) -> None:
        for row in fault_rows.trials([judge(trial)]):
            _, agent, title, seen, reported, recovered, by, alarms, remarks = row
            colour = "red" if remarks else "green"
            self._progress(
                f"  [{colour}]{agent} {title}[/]: detected {seen} s, reported {reported} s, recovered {recovered} {by}; {alarms} alarms {remarks}"
            )
        for each in trial.injections:
            if each.error:
                self._progress(f"  [red]A{each.agent:02d} {each.title} was not injected:[/] {each.error}")


def _words(trial: TrialPlan) -> str:
    return ", ".join(f"{draw.fault} on A{draw.agent:02d}" for draw in trial.draws)
