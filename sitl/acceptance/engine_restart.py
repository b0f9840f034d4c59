"""The Docker Engine restarted for real, below a running agent: `scripts/proof-engine`.

One agent with the shipped images runs on a separate engine, which is stopped or killed and started again, with `live-restore` and
without. Exit 0 only when each row holds.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

from sitl.acceptance.own_engine import OwnEngine
from sitl.acceptance.plan import configuration
from sitl.faults._world import answers, app_runs
from sitl.faults.base import Agent
from sitl.harness.compose_stack import Stack
from sitl.harness.config_overrides import write
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event
from sitl.harness.stack_monitor import StackMonitor

PROJECT = "phm-proof-engine"
AWAY_S = 20.0
"""How long there is no engine. Behind a socket that stays, connections wait instead of being refused, so PHM reports the loss only
after two calls without an answer, 10 to 11 s."""
RESTORED_LIMIT_S = 60.0
PHM_LIMIT_S = 30.0
AFTER_S = 12.0
"""Watched after the agent is OK again, so that late alarms are caught."""
OK_LIMIT_S, STEADY_S = 120.0, 5.0
ENGINE, APP = "engine", "container/ros_app"
WATCHED = (ENGINE, APP, "health/ros_app", "network/ros_app", "files/ros_app", "devices/ros_app")
"""Must be OK before and after; what the load of the machine can change does not count."""
MACHINE = "host/"


@dataclass(frozen=True)
class Case:
    """How the engine ends, and which alarms and actions are due.

    survives: the containers go on. `alarms`: units at which one alarm each is due; PHM, where it ends with the engine, can only
    report what it finds afterwards.
    """

    title: str
    live_restore: bool
    ends_by: signal.Signals
    alarms: tuple[str, ...]
    actions: tuple[str, ...] = ()
    may_leave_phm: bool = False
    """Docker Engine 20.10 takes containers that it finds running after its own crash for manually stopped, and `unless-stopped` starts
    none of them: nothing is left that could report it on board."""

    @property
    def survives(self) -> bool:
        return self.live_restore


CASES = (
    Case("stopped, live-restore", True, signal.SIGTERM, (ENGINE,)),
    Case("killed, live-restore", True, signal.SIGKILL, (ENGINE,)),
    Case("stopped", False, signal.SIGTERM, (APP,), ("start",)),
    Case("killed", False, signal.SIGKILL, (ENGINE, APP), ("start",), may_leave_phm=True),
)


@dataclass
class Row:
    """What happened in one case. `problems`: what is not as it must be."""

    title: str
    alarms: list[str] = field(default_factory=list)
    actions: list[str] = field(default_factory=list)
    starts: int = 0
    detected_s: float | None = None
    healthy_s: float | None = None
    problems: list[str] = field(default_factory=list)
    remark: str = ""


def judged(case: Case, events: list[Event], began: float, *, same_run: bool, restored: bool) -> Row:
    """The row of a case. same_run: the application container was not restarted. restored: it runs and its address answers."""
    row = Row(case.title)
    for event in events:
        if event["event"] == "fault_opened" and not event["unit"].startswith(MACHINE):
            row.alarms.append(event["unit"])
            row.detected_s = row.detected_s or event["mono"] - began
        elif event["event"] == "action" and event["phase"] == "started":
            row.actions.append(event["action"])
        elif event["event"] == "start":
            row.starts += 1
    if sorted(row.alarms) != sorted(case.alarms):
        row.problems.append(f"alarms at {', '.join(row.alarms) or 'no unit'}, expected {', '.join(case.alarms)}")
    if tuple(row.actions) != case.actions:
        row.problems.append(
            f"actions: {', '.join(row.actions) or 'none'}, expected {', '.join(case.actions) or 'none'}"
        )
    if same_run is not case.survives:
        row.problems.append("the application was restarted" if case.survives else "the application was not restarted")
    if bool(row.starts) is case.survives:
        row.problems.append(f"PHM was started {row.starts} times")
    if not restored:
        row.problems.append("the application does not run or does not answer")
    return row


def wait_ok(monitor: StackMonitor) -> None:
    """Wait until all of WATCHED have been OK in all reports of STEADY_S. Raises RuntimeError after OK_LIMIT_S."""
    levels: dict[str, str] = {}
    ok_from: list[float] = []

    def steady(event: Event) -> bool:
        if event["event"] == "unit":
            levels[event["unit"]] = event["level"]
        elif event["event"] == "report":
            if all(levels.get(unit) == "OK" for unit in WATCHED):
                ok_from.append(event["mono"])
            else:
                ok_from.clear()
        return bool(ok_from) and event["mono"] - ok_from[0] >= STEADY_S

    if monitor.record.wait(steady, OK_LIMIT_S, since=monitor.mark()) is None:
        bad = ", ".join(f"{unit} {levels.get(unit, 'not reported')}" for unit in WATCHED if levels.get(unit) != "OK")
        raise RuntimeError(f"not OK within {OK_LIMIT_S:g} s: {bad or 'not for long enough'}")


def play(engine: OwnEngine, stack: Stack, monitor: StackMonitor, case: Case) -> Row:
    """End the engine, start it again, and watch until the agent is OK."""
    wait_ok(monitor)
    generation, mark, began = stack.agent.generation, monitor.mark(), time.monotonic()
    engine.end(case.ends_by)
    time.sleep(AWAY_S)
    engine.start(live_restore=case.live_restore)
    if case.may_leave_phm and not _phm_starts(stack.agent):
        return Row(case.title, remark="the engine did not start PHM again: use live-restore")
    problem = ""
    try:
        wait_ok(monitor)
    except RuntimeError as error:
        problem = str(error)
    healthy_s = time.monotonic() - began
    until = time.monotonic() + AFTER_S
    monitor.record.wait(lambda event: event["mono"] > until, 2 * AFTER_S, since=mark)
    agent = stack.agent
    row = judged(
        case,
        monitor.record.events[mark:],
        began,
        same_run=agent.generation == generation,
        restored=_restored(agent),
    )
    row.healthy_s = healthy_s
    row.problems += [problem] if problem else []
    return row


def _phm_starts(agent: Agent) -> bool:
    """Whether the engine starts PHM within a while."""
    until = time.monotonic() + PHM_LIMIT_S
    while agent.sidecar.status != "running":
        if time.monotonic() > until:
            return False
        time.sleep(1.0)
    return True


def _restored(agent: Agent) -> bool:
    """Whether the application works again; a busy machine needs a while."""
    until = time.monotonic() + RESTORED_LIMIT_S
    while not (app_runs(agent) and answers(agent.app)):
        if time.monotonic() > until:
            return False
        time.sleep(1.0)
    return True


def table(rows: list[Row]) -> Table:
    found = Table("engine", "alarms", "actions", "detected s", "OK s", "holds")
    for row in rows:
        seen, healthy = (f"{value:.1f}" if value is not None else "-" for value in (row.detected_s, row.healthy_s))
        words = "; ".join(row.problems) or row.remark or "yes"
        found.add_row(row.title, ", ".join(row.alarms) or "-", ", ".join(row.actions) or "-", seen, healthy, words)
    return found


def run(folder: Path, console: Console, cases: Sequence[Case], *, keep_logs: bool) -> list[Row]:
    """These cases, live-restore first; `folder`: for the engine's data. Images come by standard input, as `docker save` writes them."""
    engine, rows = OwnEngine(folder), []
    engine.start(live_restore=True)
    subprocess.run(["docker", "load", "--quiet"], stdin=sys.stdin, stdout=subprocess.DEVNULL, check=True)
    stack = Stack(project=PROJECT, interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(write(configuration()))})
    live_restore = True
    try:
        stack.up()
        monitor = StackMonitor(stack)
        for case in cases:
            if case.live_restore != live_restore:  # with the other setting, and everything recreated by Compose
                stack.down(keep_logs=True)
                engine.end(signal.SIGTERM)
                engine.start(live_restore=case.live_restore)
                live_restore = case.live_restore
                stack.up()
            console.print(f"[bold]{case.title}[/]")
            rows.append(play(engine, stack, monitor, case))
            console.print("; ".join(rows[-1].problems) or rows[-1].remark or "holds")
    finally:
        stack.down(keep_logs=keep_logs)
        engine.end(signal.SIGTERM)
    if keep_logs:
        console.print(f"logs: {stack.logs}")
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/proof-engine", description=__doc__)
    parser.add_argument(
        "--data", type=Path, required=True, help="folder for the engine's data (scripts/proof-engine gives it)"
    )
    parser.add_argument("--keep-logs", action="store_true", help="do not remove PHM's log folder")
    titles = [case.title for case in CASES]
    parser.add_argument(
        "--only", nargs="+", default=(), choices=titles, metavar="CASE", help=f"of: {'; '.join(titles)}"
    )
    chosen = parser.parse_args(arguments)
    console = make_console(json=False)
    cases = [case for case in CASES if not chosen.only or case.title in chosen.only]
    rows = run(chosen.data, console, cases, keep_logs=chosen.keep_logs)
    console.print(table(rows))
    return 0 if not any(row.problems for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
