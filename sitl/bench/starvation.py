"""Starve a real agent, and check how PHM handles it: one alarm at the cause, no restart that cannot help, everything up at the end.

``python -m sitl.bench.starvation`` expects the images (`scripts/image`; PHM_IMAGE and PHM_APP_IMAGE name others) and starts a new agent for each
fault, with the shipped configuration. About 12 minutes, at most 30. Exit 0 only when every row holds. ``--markdown FILE...`` writes the table of
docs/reference/recovery.md from what earlier runs with ``--json`` have printed.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from sitl.acceptance.plan import STARVING
from sitl.bench.starvation_rows import BEGIN, END, Row, as_json, cells, from_json, markdown, not_ok, open_units
from sitl.faults import all_faults
from sitl.faults._overload import LASTS_S
from sitl.faults.base import Agent, Fault
from sitl.harness.compose_stack import ROOT, Stack
from sitl.harness.config_overrides import overridden, write
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event, Record
from sitl.harness.machine import machine

UP_LIMIT_S = 150.0
STARVED_S = 45.0
"""How long a limit is held: the restarts that it must not cause came within that time."""
OVERLOADED_S = LASTS_S + 5.0
HEALTHY_LIMIT_S = 90.0
STEADY_S = 5.0
AFTER_S = 10.0
"""How long everything is watched after it is OK again."""
REPORTS_S = 3.0
NODES = 3
ROWS = ("nothing", *STARVING)


class NoFault(Fault):
    """What the machine does to an agent by itself while this runs: the row to compare the others with."""

    name, title, unit = "nothing", "nothing", ""
    condition = ""
    layer = "companion"
    cause = "whatever else this machine is doing"
    healable = False

    def inject(self, agent: Agent) -> float:
        return time.monotonic()


class Starts:
    """Counts the starts of a container by the engine's events; they are streamed, since the engine keeps 256 only."""

    def __init__(self, stack: Stack, service: str) -> None:
        container = stack.agent.container(service)
        wanted = {"container": container.id, "event": "start"}
        self._stream = container.client.events(decode=True, filters=wanted)  # type: ignore[union-attr]
        self.count = 0
        self._thread = threading.Thread(target=self._run, name=f"starts of {service}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        for _ in self._stream:
            self.count += 1

    def close(self) -> int:
        """How many there were."""
        self._stream.close()
        self._thread.join(5.0)
        return self.count


class Trial:
    """One fault on an agent that was started for it."""

    def __init__(self, stack: Stack, console: Console) -> None:
        self.stack, self.console = stack, console
        self.record = Record(stack.record)

    def wait_healthy(self, limit_s: float) -> bool:
        """Until PHM has found everything OK for a while, the machine aside."""
        healthy_from: list[float] = []

        def steady(event: Event) -> bool:
            if event["event"] == "report":
                if not_ok(self.record.events) or not _covers(self.record.events):
                    healthy_from.clear()
                else:
                    healthy_from.append(event["mono"])
            return bool(healthy_from) and event["mono"] - healthy_from[0] >= STEADY_S

        return self.record.wait(steady, limit_s, since=self.mark()) is not None

    def play(self, fault: Fault) -> Row:
        """Inject, let it starve, clear, and wait until everything is OK. The fault is cleared however this ends."""
        row = Row(fault.name, fault.title, list(fault.places(self.stack.agent)), fault.healable)
        mark, starts = self.mark(), [Starts(self.stack, service) for service in ("ros_app", "phm")]
        try:
            moment = fault.inject(self.stack.agent)
            if fault.name != "overload_ends":
                self.watch(OVERLOADED_S if "alone" in fault.needs else STARVED_S)
            ended = time.monotonic()
            if not fault.healable:
                fault.clear(self.stack.agent)
            if self.wait_healthy(HEALTHY_LIMIT_S):
                row.healthy_again_s = max(0.0, time.monotonic() - ended - STEADY_S)
            self.watch(AFTER_S)
        finally:
            row.starts, row.sidecar_starts = (each.close() for each in starts)
            if not fault.healable:
                fault.clear(self.stack.agent)
        self.record.update()
        row.read(self.record.events[mark:], moment, open_units(self.record.events[:mark]))
        row.left = [*not_ok(self.record.events), *self._down()]
        row.judge()
        return row

    def _down(self) -> list[str]:
        """What the engine says is not up: PHM is not asked."""
        agent = self.stack.agent
        if agent.app.status != "running":
            return [f"application {agent.app.status}"]
        up = len(agent.processes(agent.app, "sitl.application.node"))
        return [] if up == NODES else [f"{up} of {NODES} nodes run"]

    def watch(self, seconds: float) -> None:
        """Let the record go on for this long."""
        until = time.monotonic() + seconds
        self.record.wait(lambda event: event["mono"] > until, 2 * seconds, since=self.mark())

    def mark(self) -> int:
        self.record.update()
        return len(self.record.events)


def _covers(events: list[Event]) -> bool:
    return any(event["event"] == "unit" for event in events)


def run(names: list[str], project: str, console: Console) -> list[Row]:
    """A row for each fault, each with its own agent."""
    rows, faults = [], {NoFault.name: NoFault(), **all_faults()}
    config = write(overridden({}))
    for name in names:
        console.print(f"[bold]{faults[name].title}[/]")
        stack = Stack(project=project, interval_s=REPORTS_S, ground_port=0, extra={"PHM_CONFIG": str(config)})
        try:
            stack.up()
            trial = Trial(stack, console)
            if not trial.wait_healthy(UP_LIMIT_S):
                raise RuntimeError(
                    f"the agent did not become OK within {UP_LIMIT_S:g} s: {not_ok(trial.record.events)}"
                )
            rows.append(trial.play(faults[name]))
        finally:
            stack.down(keep_logs=True)
        row = rows[-1]
        colour, words = ("green", "holds") if row.good else ("red", "; ".join(row.problems))
        console.print(f"  [{colour}]{words}[/]  {' | '.join(cells(row))}  (logs: {stack.logs})", highlight=False)
    return rows


def write_page(files: list[Path], page: Path) -> None:
    """The table of these measurements, between the marks of the page."""
    measured = [from_json(file) for file in files]
    text = page.read_text("utf-8")
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page} has no marks {BEGIN} and {END}")
    short = [(words.partition(" (")[0], rows) for words, rows in measured]
    where = "; ".join(words for words, _ in measured)
    page.write_text(f"{head}{begin}\nMeasured: {where}.\n\n{markdown(short)}\n{end}{tail}", "utf-8")


def end_on_signal(number: int, _frame: Any) -> None:
    """A handler that ends the program in a way that cleans up."""
    raise SystemExit(128 + number)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m sitl.bench.starvation", description=__doc__)
    parser.add_argument("--only", nargs="+", default=ROWS, choices=ROWS, metavar="FAULT", help="these faults alone")
    parser.add_argument("--project", default="phm-starved", help="Compose project (phm-starved)")
    parser.add_argument("--what", default="this code", metavar="WORDS", help="what is measured, for the table")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument(
        "--markdown", nargs="+", type=Path, metavar="FILE", help="measure nothing; write the table from these"
    )
    chosen = parser.parse_args(arguments)
    if chosen.markdown:
        write_page(chosen.markdown, ROOT / "docs" / "reference" / "recovery.md")
        return 0
    signal.signal(signal.SIGTERM, end_on_signal)
    console, began = make_console(json=chosen.json), time.monotonic()
    rows = run(list(chosen.only), chosen.project, console)
    if chosen.json:
        print(as_json(rows, machine(), chosen.what))
    bad = sum(not row.good for row in rows)
    console.print(f"{len(rows) - bad} of {len(rows)} rows hold, in {time.monotonic() - began:.0f} s")
    return 0 if not bad else 1


if __name__ == "__main__":
    sys.exit(main())
