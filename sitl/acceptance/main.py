"""Every fault class for real: one alarm at its cause, recovered and verified; `off` and `advise` change nothing.

``scripts/proof`` starts one agent with the shipped images and injects the faults one after the other. Exit 0 only
when every row holds. ``--markdown`` writes the table of docs/reference/recovery.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from rich.console import Console

from sitl.acceptance.known_late import known_s
from sitl.acceptance.plan import APART, MODES, ORDER, Play, configuration, plays
from sitl.acceptance.table import Row, print_row, print_rows, set_outcome, write_markdown
from sitl.faults import all_faults
from sitl.faults.base import Agent, Fault
from sitl.harness.compose_stack import ROOT, Stack
from sitl.harness.config_overrides import write
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event
from sitl.harness.log_queries import closed, container_state, phase, relapses
from sitl.harness.stack_monitor import StackMonitor

NOMINAL_S = 20.0
SEEN_LIMIT_S = 30.0
RECOVERED_LIMIT_S = 90.0
AFTER_S = 12.0
"""How long a fault is watched after it is recovered: longer than any grace, so late alarms are caught."""
STILL_S = 10.0
"""How long nothing may happen in the modes `off` and `advise`."""
LASTING_S = 31.0
"""Longer than `recovery.verify`, 30 s: a manual fix that lasts this long counts as permanent."""


class AcceptanceRun:
    """Makes the rows on a stack that is up."""

    def __init__(self, stack: Stack, console: Console, config: Path) -> None:
        self.stack, self.console, self._config = stack, console, config
        self.monitor = StackMonitor(stack)
        self.record = self.monitor.record
        self.mode = "act"
        self._prepared: Fault | None = None
        self._given_up: set[str] = set()

    @property
    def agent(self) -> Agent:
        return self.stack.agent

    def configure(self, mode: str, *, relaunch: bool = False, prepared: Fault | None = None) -> None:
        """Start PHM again with another configuration, that which `prepared` needs, and wait until everything is OK."""
        more = {}
        if prepared is not None:
            prepared.prepare(self.agent)
            more = dict(prepared.configuration(self.agent))
        write(configuration(mode, relaunch=relaunch, more=more), self._config)
        mark = self.monitor.mark()
        self.agent.container("phm").restart()
        if self.record.wait(lambda event: event["event"] == "start", SEEN_LIMIT_S, since=mark) is None:
            raise RuntimeError(f"PHM did not start again in mode {mode}; see {self.stack.logs}")
        self.mode = mode
        if self._prepared is not None and self._prepared is not prepared:
            self._prepared.dismantle(self.agent)
        self._prepared = prepared
        self.monitor.wait_ok()

    def nominal(self) -> list[Row]:
        """Nothing is injected: no alarm and no action while everything starts, and none after."""
        starting = Row(self.mode, "start", "nothing, while all starts", "-")
        self.monitor.wait_ok()
        mark = self.monitor.mark()
        self._fill(starting, self.record.events)
        healthy = Row(self.mode, "nominal", f"nothing, for {NOMINAL_S:g} s", "-")
        self._watch(NOMINAL_S, mark)
        self._fill(healthy, self.record.events[mark:])
        for row in (starting, healthy):
            if row.alarms or row.actions:
                row.problems.append(f"reported or done: {', '.join([*row.alarms, *row.actions])}")
        return [starting, healthy]

    def recover(self, fault: Fault, title: str = "") -> Row:
        """Inject, watch until it is recovered and verified (or given up), then whether everything is OK again."""
        row = self._row(fault, title)
        self._wait_lasting(row)
        mark = self.monitor.mark()
        moment = fault.inject(self.agent)
        if fault.healable:
            for unit in row.expected:
                limit_s = RECOVERED_LIMIT_S + known_s(fault.name, fault.evidence_s)  # some are known late
                self.record.wait(partial(phase, "verified", unit), limit_s, since=mark)
        else:
            self.record.wait(lambda event: event["event"] == "fault_opened", SEEN_LIMIT_S, since=mark)
            if self._acted(mark):
                self.record.wait(partial(phase, "escalated", row.unit), RECOVERED_LIMIT_S, since=mark)
        self._watch(AFTER_S, mark)
        self._fill(row, self.record.events[mark:], moment)
        row.problems += relapses(row.expected, self.record.events[mark:])
        cleared = self.monitor.mark()
        fault.clear(self.agent)
        self._healthy_again(row, mark)
        set_outcome(row, healable=fault.healable)
        self._judge_condition(row, fault, mark)
        if row.given_up_s is not None:
            self._given_up.add(row.unit)
        later = [event["action"] for event in self.record.events[cleared:] if phase("verified", row.unit, event)]
        if later:
            row.outcome += f"; {', '.join(later)} once it was fixed"
        return row

    def leave_alone(self, fault: Fault) -> Row:
        """In `off` and `advise` the fault is reported and the application container stays unchanged."""
        row = self._row(fault)
        self._wait_lasting(row)
        mark = self.monitor.mark()
        moment = fault.inject(self.agent)
        before = container_state(self.agent)
        self.record.wait(lambda event: event["event"] == "fault_opened", SEEN_LIMIT_S, since=mark)
        self._watch(STILL_S, mark)
        after = container_state(self.agent)
        events = self.record.events[mark:]
        self._fill(row, events, moment)
        if before != after:
            row.problems.append(f"the container changed: {before} became {after}")
        if row.actions or any(closed(row.unit, event) for event in events):
            row.problems.append("something was done")
        if bool(row.advised) != (self.mode == "advise"):
            row.problems.append(f"advised: {row.advised or 'nothing'}")
        row.outcome = "reported, container unchanged" if not row.problems else "changed"
        fault.clear(self.agent)
        self._healthy_again(row, mark)
        if sorted(row.alarms) != sorted(row.expected):
            row.problems.append(f"alarms: {row.alarms}")
        self._judge_condition(row, fault, mark)
        return row

    def _row(self, fault: Fault, title: str = "") -> Row:
        self.console.print(f"[bold]{self.mode}[/]  {title or fault.title}")
        unit, *also = (each.format(agent=self.stack.agent_name) for each in (fault.unit, *fault.also))
        return Row(self.mode, fault.name, title or fault.title, unit, also)

    def _wait_lasting(self, row: Row) -> None:
        """What PHM gave up on before it tries again only after that was OK for so long, as this run of PHM has seen it."""
        if row.unit not in self._given_up:
            return
        mark = self.monitor.mark()
        reported = (
            event["mono"]
            for event in self.record.events
            if event["event"] == "transition" and event["unit"] == row.unit
        )
        until = max(reported, default=0.0) + LASTING_S
        self.record.wait(lambda event: event["mono"] > until, 2 * LASTING_S, since=mark)

    def _watch(self, seconds: float, mark: int) -> None:
        """Let the record go on for this long; reports come every few seconds, so it does."""
        until = time.monotonic() + seconds
        self.record.wait(lambda event: event["mono"] > until, 2 * seconds, since=mark)

    def _acted(self, mark: int) -> bool:
        """Whether PHM tries something within a moment."""
        return (
            self.record.wait(lambda event: event["event"] == "action" and event["phase"] == "started", 3.0, since=mark)
            is not None
        )

    def _fill(self, row: Row, events: list[Event], moment: float = 0.0) -> None:
        """Read off the record what happened; alarms at other units count as well. Of several units, the last one counts."""
        seen: dict[str, float] = {}
        verified: dict[str, float] = {}
        for event in events:
            unit, after = event.get("unit", ""), event["mono"] - moment
            if unit in row.expected and phase("verified", unit, event):
                verified.setdefault(unit, after)
            if event["event"] == "fault_opened":
                row.alarm(unit)
                seen.setdefault(unit, after)
                row.summary = row.summary or (event["summary"] if unit == row.unit else "")
            elif event["event"] == "action":
                if event["phase"] == "started":
                    row.actions.append(event["action"])
                elif event["phase"] == "advised":
                    row.advised.append(event["action"])
                elif phase("escalated", row.unit, event):
                    row.given_up_s = after
        row.detected_s = max(seen[unit] for unit in row.expected) if seen.keys() >= set(row.expected) else None
        row.recovered_s = max(verified.values()) if verified.keys() == set(row.expected) else None

    def _judge_condition(self, row: Row, fault: Fault, mark: int) -> None:
        """The alarm was for this fault and no other at the same unit. It may have been another thing for a moment first."""
        events = (event for event in self.record.events[mark:] if event.get("unit") == row.unit)
        seen = {event["condition"] for event in events if event.get("condition")}
        if fault.condition not in seen:
            row.problems.append(f"known as {', '.join(sorted(seen)) or 'nothing'}, expected {fault.condition}")

    def _healthy_again(self, row: Row, mark: int) -> None:
        """Everything is OK again, and neither recovery nor clearing raised a further alarm."""
        try:
            self.monitor.wait_ok()
        except RuntimeError as error:
            row.problems.append(str(error))
        self.record.update()
        row.alarms, row.beside = [], []
        for event in self.record.events[mark:]:
            if event["event"] == "fault_opened":
                row.alarm(event["unit"])


def run(stack: Stack, console: Console, config: Path, programme: Iterable[Play]) -> list[Row]:
    """All rows of the programme, on a stack that is up with the configuration of the mode `act`."""
    proof, faults = AcceptanceRun(stack, console, config), all_faults()
    rows = [print_row(row, console) for row in proof.nominal()]
    for play in programme:
        if not play.first:
            alone = faults[play.faults[0]] if play.apart else None
            proof.configure(play.mode, relaunch=play.relaunch, prepared=alone)
        for name in play.faults:
            title = f"{faults[name].title}, `relaunch` configured" if play.relaunch else ""
            row = proof.recover(faults[name], title) if play.mode == "act" else proof.leave_alone(faults[name])
            rows.append(print_row(row, console))
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/proof", description=__doc__)
    faults, modes = (*ORDER, *APART), ", ".join(MODES)
    parser.add_argument("--only", nargs="+", default=(), choices=faults, metavar="FAULT", help="these faults alone")
    parser.add_argument("--mode", nargs="+", default=MODES, choices=MODES, metavar="MODE", help=f"of {modes}")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--markdown", action="store_true", help="write the table of docs/reference/recovery.md")
    parser.add_argument("--keep-logs", action="store_true", help="do not remove the log folder")
    chosen = parser.parse_args(arguments)
    console = make_console(json=chosen.json)
    config = write(configuration())
    stack = Stack(project="phm-proof", interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(config)})
    began = time.monotonic()
    try:
        with console.status("starting the agent"):
            stack.up()
        rows = run(stack, console, config, plays(chosen.only, chosen.mode))
    finally:
        stack.down(keep_logs=chosen.keep_logs)
    code = print_rows(rows, console, json=chosen.json)
    if chosen.markdown:
        write_markdown(rows, ROOT / "docs" / "reference" / "recovery.md")
    if chosen.keep_logs:
        console.print(f"logs: {stack.logs}")
    console.print(f"in {time.monotonic() - began:.0f} s")
    return code


if __name__ == "__main__":
    sys.exit(main())
