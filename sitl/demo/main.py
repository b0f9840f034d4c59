"""The demonstration: one agent for real, four faults, each detected, reported once at its cause, recovered and verified.

``python -m sitl.demo`` expects an engine and the images (`scripts/demo` makes both). Exit 0 only when every
fault was opened exactly once, at the right check, was recovered by PHM and verified, and the ground received it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.table import Table

from phm.core.model import Slot
from phm.gcs.statustext_parser import parse
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.harness.compose_stack import Stack
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event, Record
from sitl.harness.machine import machine
from sitl.simulation.ground import Ground, TextLine

STORY = ("node_killed", "network_disconnected", "container_stopped", "unhealthy")
CLEAN_LIMIT_S = 90.0
FAULT_LIMIT_S = 60.0
AFTER_S = 12.0
"""How long each fault is watched after it is recovered: longer than any grace, so late alarms are caught."""


@dataclass
class Outcome:
    """What became of one fault; seconds from the moment it was there. None: it did not happen."""

    fault: Fault
    unit: str
    opened: list[Event]
    detected_s: float | None = None
    reported_s: float | None = None
    recovered_s: float | None = None
    by: str = ""

    @property
    def good(self) -> bool:
        once = [event["unit"] for event in self.opened] == [self.unit]
        return once and None not in (self.detected_s, self.reported_s, self.recovered_s) and bool(self.by)


class Demo:
    """Runs the story on a stack that is up, and prints as it goes."""

    def __init__(self, stack: Stack, console: Console) -> None:
        self.stack, self.console = stack, console
        self.record = Record(stack.record)
        self.ground = Ground(f"tcp:127.0.0.1:{stack.ground_port}")

    def clean_pass(self) -> bool:
        """Wait for a report in which slots 1 to 8 are all OK, as the ground sees it too."""
        with self.console.status("waiting for the first clean report"):
            report = self.record.wait(self._all_healthy, CLEAN_LIMIT_S)
        if report is None:
            self.console.print("[red]no clean report came[/]; the last lines of the log:")
            self._print_log_tail()
            return False
        self.console.print(f"[green]clean[/]   report {report['number']}: {report['status_array']}")
        return True

    def play(self, fault: Fault) -> Outcome:
        """Inject one fault and watch until it is recovered and everything is OK again."""
        self.record.update()
        mark, received = len(self.record.events), len(self.ground.lines)
        unit = fault.unit.format(agent=self.stack.agent_name)
        self.console.print(f"\n[bold]inject[/]  {fault.title}")
        moment = fault.inject(self.stack.agent)
        with self.console.status(f"{fault.title}: watching"):
            self.record.wait(lambda event: _verified(event, unit), FAULT_LIMIT_S, since=mark)
            quiet_from = time.monotonic()
            self.record.wait(lambda event: event["mono"] > quiet_from + AFTER_S, 2 * AFTER_S, since=mark)
        fault.clear(self.stack.agent)
        return self._judge(fault, unit, moment, mark, received)

    def _judge(self, fault: Fault, unit: str, moment: float, mark: int, received: int) -> Outcome:
        events, lines = self.record.events[mark:], list(self.ground.lines)[received:]
        for line in lines:
            self.console.print(f"[cyan]ground[/]  {line.text}")
        for event in events:
            if event["event"] == "fault_opened":
                self.console.print(f"[red]fault[/]   {event['unit']}: {event['summary']}")
        return judge(fault, unit, moment, events, lines)

    def table(self, outcomes: list[Outcome]) -> Table:
        table = Table(title="Faults of this run, seconds after each was there", box=box.SIMPLE_HEAD)
        for name in ("fault", "seen at", "alarms", "detected", "reported", "recovered", "by", ""):
            number = name in ("alarms", "detected", "reported", "recovered")
            table.add_column(name, justify="right" if number else "left", overflow="fold", no_wrap=number)
        for entry in outcomes:
            verdict = "[green]ok[/]" if entry.good else "[red]NOT OK[/]"
            times = (_seconds(entry.detected_s), _seconds(entry.reported_s), _seconds(entry.recovered_s))
            table.add_row(entry.fault.title, entry.unit, str(len(entry.opened)), *times, entry.by or "-", verdict)
        return table

    def _all_healthy(self, event: Event) -> bool:
        return bool(event["event"] == "report" and all(digit == 1 for digit in event["status_array"]))

    def _print_log_tail(self) -> None:
        text = self.stack.logs / "phm.log"
        lines = text.read_text(errors="replace").splitlines()[-40:] if text.exists() else ["(there is no log)"]
        for line in lines:
            self.console.print(line, markup=False, highlight=False)


def judge(fault: Fault, unit: str, moment: float, events: Sequence[Event], lines: Sequence[TextLine]) -> Outcome:
    """What became of a fault that was there from `moment` on, by PHM's record and by what the ground received.

    A busy machine may well raise an alarm about its own load meanwhile: that is shown, and is not what is judged.
    """
    opened = [event for event in events if event["event"] == "fault_opened"]
    named = next((event for event in opened if event["unit"] == unit), None)
    recovered = next((event for event in events if _verified(event, unit)), None)
    outcome = Outcome(fault, unit, [event for event in opened if event["slot"] != Slot.HOST])
    if named is not None:
        received = next((line for line in lines if _reports(line.text, named["slot"])), None)
        outcome.detected_s = named["mono"] - moment
        outcome.reported_s = received.mono - moment if received is not None else None
    if recovered is not None:
        outcome.recovered_s, outcome.by = recovered["mono"] - moment, recovered["action"]
    return outcome


def _reports(text: str, slot: int) -> bool:
    """Whether a STATUSTEXT says that a unit of this slot has failed."""
    line = parse(text)
    return line is not None and line.word == "FAIL" and line.slot == slot


def _verified(event: Event, unit: str) -> bool:
    return bool(event["event"] == "action" and event["phase"] == "verified" and event["unit"] == unit)


def as_json(outcomes: list[Outcome]) -> str:
    rows = [
        {
            "fault": entry.fault.name,
            "unit": entry.unit,
            "alarms": [event["unit"] for event in entry.opened],
            "detected_s": entry.detected_s,
            "reported_s": entry.reported_s,
            "recovered_s": entry.recovered_s,
            "by": entry.by,
            "good": entry.good,
        }
        for entry in outcomes
    ]
    return json.dumps({"machine": machine(), "faults": rows}, indent=2)


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def run(stack: Stack, console: Console, *, json_too: bool = False) -> int:
    """The whole story on a stack that is up; 0 when all of it happened. `json_too` prints the outcomes as JSON."""
    demo = Demo(stack, console)
    demo.ground.start()
    try:
        if not demo.clean_pass():
            return 1
        faults = all_faults()
        outcomes = []
        for name in STORY:
            outcomes.append(demo.play(faults[name]))
            demo.record.wait(demo._all_healthy, CLEAN_LIMIT_S, since=len(demo.record.events))
        console.print()
        console.print(demo.table(outcomes))
        if json_too:
            print(as_json(outcomes))
        return 0 if all(entry.good for entry in outcomes) else 1
    finally:
        demo.ground.stop()


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/demo", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="leave the agent running at the end")
    parser.add_argument("--interval", type=float, default=20.0, metavar="SECONDS", help="between full reports (20)")
    parser.add_argument("--project", default="phm-demo", metavar="NAME", help="name of the Compose project (phm-demo)")
    parser.add_argument("--ground-port", type=int, default=5760, metavar="PORT", help="where the ground listens (5760)")
    parser.add_argument("--json", action="store_true", help="print the outcomes as JSON, all else to the error stream")
    chosen = parser.parse_args(arguments)
    console = make_console(json=chosen.json)
    stack = Stack(chosen.project, interval_s=chosen.interval, ground_port=chosen.ground_port)
    try:
        with console.status("starting the agent: application, PHM, simulated autopilot"):
            stack.up()
        return run(stack, console, json_too=chosen.json)
    finally:
        if chosen.keep:
            console.print(f"left running: docker compose -p {stack.project} ps; logs in {stack.logs}")
            console.print(f"to end it: docker compose -p {stack.project} down --volumes")
        else:
            stack.down()


if __name__ == "__main__":
    sys.exit(main())
