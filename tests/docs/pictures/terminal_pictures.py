"""The pictures of `phm status`, `phm gcs` and `phm demo`: real processes in a terminal, real faults, a real recovery."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rich.text import Text

from phm.simulation.demo import DemoPorts
from tests.docs.pictures import catalog
from tests.docs.pictures.agents import BUSY, DEAD, PictureAgents, agents
from tests.docs.pictures.terminal import terminal, write_svg
from tests.fakes.until import until

PHM = (sys.executable, "-m", "phm.cli")
STATUS_COLUMNS, STATUS_ROWS = 116, 60
TABLE_COLUMNS, TABLE_ROWS = 110, 32
POLL_S, LIMIT_S = 0.2, 300.0
FIRST_FAULT, FIRST_FAULT_OVER, LAST_FAULT = "A02 FAIL 10", "A02 OK", "A03 broken at companion"
DEMO_RUNS = 3
"""Both faults of `phm demo` are there for a few seconds, and on a busy machine another agent may miss a measurement just then."""
PROVEN_S = 10.0
"""How long PHM has received the autopilot before its connection fails: longer than the settling of a start."""


def take(state: Path, folder: Path, ports: DemoPorts, demo_ports: DemoPorts) -> None:
    """Write each picture into `folder`. Raises AssertionError where a picture would not show what its caption says.

    state: an empty folder for the agents.
    """
    for name in ("agents", "demo"):
        (state / name).mkdir()
    _status_and_gcs(state / "agents", folder, ports)
    _demo(state / "demo", folder, demo_ports)


def _status_and_gcs(state: Path, folder: Path, ports: DemoPorts) -> None:
    words = [*PHM, "gcs", "--pilot", f"udpin:127.0.0.1:{ports.ground}"]
    with terminal(words, TABLE_COLUMNS, TABLE_ROWS) as gcs, agents(state, ports) as swarm:

        def seen() -> object:
            return swarm.logs(), gcs.screen().plain

        until(lambda: _healthy(swarm), "four agents without a fault", seen, limit_s=LIMIT_S, poll_s=POLL_S)
        swarm.relay.stall()
        until(lambda: _resolved(swarm.status(BUSY)), "the reopened connection", seen, limit_s=LIMIT_S, poll_s=POLL_S)
        swarm.kill_planner(BUSY)
        swarm.kill_daemon(DEAD)
        until(lambda: _blocked(swarm.status(BUSY)), "the fault of the planner", seen, limit_s=LIMIT_S, poll_s=POLL_S)
        lost = f"A{DEAD:02d} broken at companion"

        def complete() -> Text | None:
            """The table with all that its caption says: on a busy machine another agent may miss a measurement just then."""
            screen = gcs.screen()
            if lost not in screen.plain:
                return None
            shown = _since_fault(screen)
            return None if catalog.missing("gcs.svg", shown.plain) else shown

        table: Text = until(complete, "the loss of an agent", seen, limit_s=LIMIT_S, poll_s=POLL_S)
        with terminal([*PHM, "status", "--run-dir", str(swarm.run_dir(BUSY))], STATUS_COLUMNS, STATUS_ROWS) as status:
            shown = status.output()
    _write(folder, "status.svg", "phm status", _until_array(shown), STATUS_COLUMNS)
    _write(folder, "gcs.svg", "phm gcs", table, TABLE_COLUMNS)


def _demo(state: Path, folder: Path, ports: DemoPorts) -> None:
    for _ in range(DEMO_RUNS):
        shown = _demo_screen(state, ports)
        if not catalog.missing("demo.svg", shown.plain):
            break
    _write(folder, "demo.svg", "phm demo", shown, TABLE_COLUMNS)


def _demo_screen(state: Path, ports: DemoPorts) -> Text:
    """The first drawing with everything that the caption says, or else one from after the first fault."""
    options = ("--for", "300", "--first-port", str(ports.first), "--ground-port", str(ports.ground))
    with terminal([*PHM, "demo", *options], TABLE_COLUMNS, TABLE_ROWS, {"TMPDIR": str(state)}) as demo:

        def complete() -> Text | None:
            screen = demo.screen()
            if LAST_FAULT not in screen.plain:
                return None
            shown = _since_fault(screen)
            return shown if FIRST_FAULT_OVER in shown.plain or not catalog.missing("demo.svg", shown.plain) else None

        shown: Text = until(complete, "both faults", lambda: demo.screen().plain, limit_s=LIMIT_S, poll_s=POLL_S)
    return shown


def _healthy(swarm: PictureAgents) -> bool:
    """Whether no agent has a fault and each has known its autopilot for a while."""
    documents = [swarm.status(agent) for agent in swarm.agents]
    if not all(document.get("checks") for document in documents):
        return False
    levels = {check["level"] for document in documents for check in document["checks"]}
    up_s = min(document["health"]["uptime_s"] for document in documents)
    return not levels & {"ERROR", "STALE"} and up_s > PROVEN_S


def _resolved(document: dict[str, Any]) -> bool:
    return any(fault["by"] == "reopen" for fault in document["faults"]["closed"]) and not document["faults"]["open"]


def _blocked(document: dict[str, Any]) -> bool:
    return any(fault["unit"] == "custom/planner" and fault["blocks"] for fault in document["faults"]["open"])


def _until_array(shown: Text) -> Text:
    """Without what follows the Status Array: priority and counters of PHM's own process, which are of this machine."""
    lines = shown.split("\n")
    last = next(number for number, line in enumerate(lines) if line.plain.startswith("Status Array"))
    return Text("\n").join(lines[: last + 1])


def _since_fault(shown: Text) -> Text:
    """As a lower terminal shows it: the table, and the newest lines from the first fault on."""
    lines = shown.split("\n")
    keys = next(number for number, line in enumerate(lines) if line.plain.startswith("up/down"))
    first = next((number for number, line in enumerate(lines) if FIRST_FAULT in line.plain and number > keys), keys + 1)
    return Text("\n").join([*lines[: keys + 1], *lines[first:]])


def _write(folder: Path, name: str, title: str, shown: Text, columns: int) -> None:
    catalog.check(name, shown.plain)
    write_svg(folder / name, title, shown, columns)
    catalog.check(name, "\n".join(catalog.svg_lines((folder / name).read_text("utf-8"))))
