"""Every fault class for real: one alarm at its cause, healed and verified; `off` and `advise` touch nothing.

``scripts/proof`` starts one agent with the shipped images and injects the faults one after the other. Exit 0 only
when every row holds. ``--markdown`` writes the table of docs/recovery.md.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from sitl.bench import Bench
from sitl.derived import derived, write
from sitl.faults import all_faults
from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CONTENT
from sitl.prooftable import Row, as_json, judged_words, rich_table, write_markdown
from sitl.record import Event
from sitl.stack import ROOT, Stack

NOMINAL_S = 20.0
SEEN_LIMIT_S = 30.0
HEALED_LIMIT_S = 90.0
AFTER_S = 12.0
"""How long a fault is watched after it is healed: longer than any grace, so late alarms are caught."""
STILL_S = 10.0
"""How long nothing may happen in the modes `off` and `advise`."""
ORDER = (
    "container_stopped", "network_disconnected", "container_killed", "unhealthy", "container_paused", "node_killed",
    "container_oom", "file_deleted", "node_stopped", "file_not_executable", "topic_silent", "device_gone",
    "topic_slow", "device_back", "file_altered", "crash_loop",
)  # fmt: skip
"""Neighbours break different units, so that no fault is taken for the return of the one before it."""
LEFT_ALONE = ("node_killed", "network_disconnected", "container_stopped")
RELAUNCH = (
    '["ros-entrypoint", "python", "-m", "sitl.node", "--name", "node_1", "--namespace", "/agent_1", '
    '"--publish", "topic_1:10", "--subscribe", "topic_3"]'
)


def configuration(mode: str = "act", *, relaunch: bool = False) -> str:
    """The shipped configuration with room for so many faults in a row, and files that can be judged and restored."""
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    changes = {
        "\n  budget: 5": "\n  budget: 100",
        "\n  mode: act": f"\n  mode: {mode}",
        '#sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"': f'sha256: "{sha256}"',
        "#restore: image": "restore: image",
    }
    if relaunch:
        changes["#relaunch: [ros2, run, my_package, node_1]"] = f"relaunch: {RELAUNCH}"
    return derived(changes)


class Proof:
    """Makes the rows on a stack that is up."""

    def __init__(self, stack: Stack, console: Console, config: Path) -> None:
        self.stack, self.console, self._config = stack, console, config
        self.bench = Bench(stack, console)
        self.record = self.bench.record
        self.mode = "act"

    @property
    def agent(self) -> Agent:
        return self.stack.agent

    def configure(self, mode: str, *, relaunch: bool = False) -> None:
        """Start PHM again with another configuration, and wait until everything is well."""
        write(configuration(mode, relaunch=relaunch), self._config)
        mark = self._mark()
        self.agent.container("phm").restart()
        if self.record.wait(lambda event: event["event"] == "start", SEEN_LIMIT_S, since=mark) is None:
            raise RuntimeError(f"PHM did not start again in mode {mode}; see {self.stack.logs}")
        self.mode = mode
        self.bench.wait_well()

    def nominal(self) -> list[Row]:
        """Nothing is injected: no alarm and no action while everything starts, and none after."""
        starting = Row(self.mode, "start", "nothing, while all starts", "-")
        self.bench.wait_well()
        mark = self._mark()
        self._fill(starting, self.record.events)
        well = Row(self.mode, "nominal", f"nothing, for {NOMINAL_S:g} s", "-")
        self._watch(NOMINAL_S, mark)
        self._fill(well, self.record.events[mark:])
        for row in (starting, well):
            if row.alarms or row.actions:
                row.problems.append(f"told or done: {', '.join([*row.alarms, *row.actions])}")
        return [starting, well]

    def heal(self, fault: Fault, title: str = "") -> Row:
        """Inject, watch until it is healed and verified (or given up), then whether everything is well again."""
        row = self._row(fault, title)
        mark = self._mark()
        moment = fault.inject(self.agent)
        if fault.healable:
            self.record.wait(lambda event: _phase(event, "verified", row.unit), HEALED_LIMIT_S, since=mark)
        else:
            self.record.wait(lambda event: event["event"] == "fault_opened", SEEN_LIMIT_S, since=mark)
            if self._acted(mark):
                self.record.wait(lambda event: _phase(event, "escalated", row.unit), HEALED_LIMIT_S, since=mark)
        self._watch(AFTER_S, mark)
        self._fill(row, self.record.events[mark:], moment)
        cleared = self._mark()
        fault.clear(self.agent)
        self._well_again(row, mark)
        judged_words(row, healable=fault.healable)
        later = [event["action"] for event in self.record.events[cleared:] if _phase(event, "verified", row.unit)]
        if later:
            row.outcome += f"; {', '.join(later)} once it was mended"
        return row

    def leave_alone(self, fault: Fault) -> Row:
        """In `off` and `advise` the fault is told and the application container stays as the fault left it."""
        row = self._row(fault)
        mark = self._mark()
        moment = fault.inject(self.agent)
        before = world(self.agent)
        self.record.wait(lambda event: event["event"] == "fault_opened", SEEN_LIMIT_S, since=mark)
        self._watch(STILL_S, mark)
        after = world(self.agent)
        events = self.record.events[mark:]
        self._fill(row, events, moment)
        if before != after:
            row.problems.append(f"the container changed: {before} became {after}")
        if row.actions or any(_closed(event, row.unit) for event in events):
            row.problems.append("something was done")
        if bool(row.advised) != (self.mode == "advise"):
            row.problems.append(f"advised: {row.advised or 'nothing'}")
        row.outcome = "told, container unchanged" if not row.problems else "changed"
        fault.clear(self.agent)
        self._well_again(row, mark)
        if row.alarms != [row.unit]:
            row.problems.append(f"alarms: {row.alarms}")
        return row

    def _row(self, fault: Fault, title: str = "") -> Row:
        self.console.print(f"[bold]{self.mode}[/]  {title or fault.title}")
        unit = fault.unit.format(agent=self.stack.agent_name)
        return Row(self.mode, fault.name, title or fault.title, unit)

    def _mark(self) -> int:
        self.record.update()
        return len(self.record.events)

    def _watch(self, seconds: float, mark: int) -> None:
        """Let the record go on for so long; reports come every few seconds, so it does."""
        until = time.monotonic() + seconds
        self.record.wait(lambda event: event["mono"] > until, 2 * seconds, since=mark)

    def _acted(self, mark: int) -> bool:
        """Whether PHM tries something within a moment."""
        return (
            self.record.wait(lambda event: event["event"] == "action" and event["phase"] == "started", 3.0, since=mark)
            is not None
        )

    def _fill(self, row: Row, events: list[Event], moment: float = 0.0) -> None:
        """Read off the record what happened; alarms at other units count as well."""
        for event in events:
            if event["event"] == "fault_opened":
                row.alarm(event["unit"])
                if event["unit"] == row.unit and row.detected_s is None:
                    row.detected_s, row.summary = event["mono"] - moment, event["summary"]
            elif event["event"] == "action":
                if event["phase"] == "started":
                    row.actions.append(event["action"])
                elif event["phase"] == "advised":
                    row.advised.append(event["action"])
                elif _phase(event, "escalated", row.unit):
                    row.given_up_s = event["mono"] - moment
                elif _phase(event, "verified", row.unit) and row.healed_s is None:
                    row.healed_s = event["mono"] - moment

    def _well_again(self, row: Row, mark: int) -> None:
        """Everything is well again, and neither healing nor clearing raised a further alarm."""
        try:
            self.bench.wait_well()
        except RuntimeError as error:
            row.problems.append(str(error))
        self.record.update()
        row.alarms, row.beside = [], []
        for event in self.record.events[mark:]:
            if event["event"] == "fault_opened":
                row.alarm(event["unit"])


def world(agent: Agent) -> Mapping[str, Any]:
    """What PHM could have changed about the application container."""
    attrs = agent.app.attrs
    networks = attrs["NetworkSettings"]["Networks"]
    return {
        "id": attrs["Id"][:12],
        "started": attrs["State"]["StartedAt"],
        "status": attrs["State"]["Status"],
        "networks": {name: network["NetworkID"][:12] for name, network in networks.items()},
    }


def _closed(event: Event, unit: str) -> bool:
    return bool(event["event"] == "fault_closed" and event["unit"] == unit)


def _phase(event: Event, phase: str, unit: str) -> bool:
    return bool(event["event"] == "action" and event["phase"] == phase and event["unit"] == unit)


def run(stack: Stack, console: Console, config: Path, only: tuple[str, ...] = ()) -> list[Row]:
    """All rows, or those of the faults in `only`, on a stack that is up."""
    proof, faults = Proof(stack, console, config), all_faults()
    wanted = [name for name in ORDER if not only or name in only]
    rows = [_told(row, console) for row in proof.nominal()]
    for name in wanted:
        rows += [_told(proof.heal(faults[name]), console)]
    if "node_killed" in wanted:
        proof.configure("act", relaunch=True)
        rows.append(_told(proof.heal(faults["node_killed"], "node killed, `relaunch` configured"), console))
    for mode in ("off", "advise"):
        names = [name for name in LEFT_ALONE if name in wanted]
        if names:
            proof.configure(mode)
        for name in names:
            rows += [_told(proof.leave_alone(faults[name]), console)]
    return rows


def _told(row: Row, console: Console) -> Row:
    colour, words = ("green", "holds") if row.good else ("red", "; ".join(row.problems))
    console.print(f"  [{colour}]{words}[/]  {row.outcome}, {', '.join(row.actions) or 'no action'}", highlight=False)
    return row


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/proof", description=__doc__)
    parser.add_argument("--only", nargs="+", default=(), choices=ORDER, metavar="FAULT", help="these faults alone")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--markdown", action="store_true", help="write the table of docs/recovery.md")
    parser.add_argument("--keep-logs", action="store_true", help="do not remove the log folder")
    chosen = parser.parse_args(arguments)
    console = Console(stderr=chosen.json)
    config = write(configuration())
    stack = Stack(project="phm-proof", interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(config)})
    began = time.monotonic()
    try:
        with console.status("starting the agent"):
            stack.up()
        rows = run(stack, console, config, tuple(chosen.only))
    finally:
        stack.down(keep_logs=chosen.keep_logs)
    if chosen.json:
        print(as_json(rows))
    else:
        console.print(rich_table(rows))
    if chosen.markdown:
        write_markdown(rows, ROOT / "docs" / "recovery.md")
    if chosen.keep_logs:
        console.print(f"logs: {stack.logs}")
    bad = sum(not row.good for row in rows)
    console.print(f"{len(rows) - bad} of {len(rows)} rows hold, in {time.monotonic() - began:.0f} s")
    return 0 if not bad else 1


if __name__ == "__main__":
    sys.exit(main())
