"""What `phm learn` wrote, unaltered: no alarm while nothing happens, and one alarm at its cause for each fault of the demonstration.

``python -m sitl.acceptance.learned`` expects an engine and the images (`scripts/engine start`, `scripts/image`). The learned file asks for
no recovery, so that each fault is undone here. Exit 0 only when every row holds.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml
from docker.errors import DockerException
from rich.console import Console

from sitl.acceptance.known_late import known_s
from sitl.acceptance.table import Row, print_row, print_rows
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.faults.file_deleted import put_back
from sitl.harness.compose_stack import FILES, Stack
from sitl.harness.config_overrides import write
from sitl.harness.console import make_console
from sitl.harness.log_follower import Event
from sitl.harness.stack_monitor import StackMonitor, no_slot_failed

FAULTS = (
    "node_killed",
    "node_stopped",
    "executor_deadlocked",
    "container_stopped",
    "container_killed",
    "container_paused",
    "container_oom",
    "container_created",
    "network_disconnected",
    "sidecar_disconnected",
    "address_silent",
    "file_deleted",
    "file_altered",
    "unhealthy",
    "device_gone",
    "node_duplicate",
    "subscriber_lost",
    "qos_mismatch",
    "topic_slow",
    "topic_silent",
)
CONDITIONS = {"file_deleted": "tree_altered", "file_altered": "tree_altered"}
"""A folder is learned as a manifest, whose conditions are other ones."""
BEFORE = """\
agent:
  name: "${PHM_AGENT}"
  id: ${PHM_AGENT_ID}
host:
  dev_root: "${PHM_DEV_ROOT}"
containers:
  - {name: "${PHM_APP}", alias: ros_app, networks: ["${PHM_NETWORK}"]}
mavlink:
  endpoints: [{url: "${PHM_MAVLINK}"}]
recovery:
  on_manual_stop: heal
"""
"""What is there before: as much as PHM needs to join the application's network, and that a container that the script pauses is a
failure, although the vehicle is disarmed."""
FOLDER = "ros_app:/ws"
SEEN_LIMIT_S, START_LIMIT_S, LEARN_LIMIT_S = 60.0, 90.0, 600.0
"""The first: since PHM may know of the fault (`sitl.acceptance.known_late.known_s`)."""
RESTORED_LIMIT_S = 20.0
AFTER_S = 8.0
"""How long a fault stays after its alarm, so that late alarms are caught."""


class LearnedRun:
    """Learns the configuration of a stack that is up, runs PHM with it, and makes the rows."""

    def __init__(self, stack: Stack, console: Console, folder: Path) -> None:
        self.stack, self.console, self.folder = stack, console, folder
        self.monitor = StackMonitor(stack, no_slot_failed)
        self.record = self.monitor.record

    def learn(self, watch: str) -> str:
        """Runs `phm learn` in the sidecar, then PHM with what it has written; returns that."""
        argv = ["phm", "learn", "--for", watch, "--files", FOLDER, "--output", "/etc/phm/learned.yaml"]
        sidecar = self.stack.agent.sidecar.name
        done = subprocess.run(
            ["docker", "exec", str(sidecar), *argv],
            capture_output=True,
            text=True,
            timeout=LEARN_LIMIT_S,
            check=False,
        )
        if done.returncode != 0:
            raise RuntimeError(f"phm learn ended with {done.returncode}:\n{done.stderr.strip()}")
        text = (self.folder / "learned.yaml").read_text("utf-8")
        write(text, self.folder / "phm.yaml")
        mark = self.monitor.mark()
        self.stack.agent.sidecar.restart()
        if self.record.wait(lambda event: event["event"] == "start", START_LIMIT_S, since=mark) is None:
            raise RuntimeError(f"PHM did not start with what was learned; see {self.stack.logs}")
        return text

    def clean(self, seconds: float) -> Row:
        """Nothing is injected."""
        row = Row("learned", "nominal", f"nothing, for {seconds:g} s", "-")
        self.monitor.wait_ok()
        mark = self.monitor.mark()
        until_s = time.monotonic() + seconds
        with self.console.status(f"nothing is injected for {seconds:g} s"):
            self.record.wait(lambda event: event["mono"] > until_s, 2 * seconds, since=mark)
        judge_quiet(row, self._events(mark))
        return row

    def play(self, fault: Fault) -> Row:
        """Inject it, wait for its alarm and what follows, and undo it."""
        unit, *also = fault.places(self.stack.agent)
        row = Row("learned", fault.name, fault.title, unit, also)
        mark = self.monitor.mark()
        moment = fault.inject(self.stack.agent)
        limit_s = SEEN_LIMIT_S + known_s(fault.name, fault.evidence_s)
        opened = self.record.wait(lambda event: _opens(event, row), limit_s, since=mark)
        if opened is not None:
            self.record.wait(
                lambda event: event["mono"] > opened["mono"] + AFTER_S, 2 * AFTER_S + SEEN_LIMIT_S, since=mark
            )
            row.detected_s = opened["mono"] - moment
        self._restore(fault)
        try:
            self.monitor.wait_ok()
        except RuntimeError as error:
            row.problems.append(str(error))
        judge_fault(row, self._events(mark), CONDITIONS.get(fault.name, fault.condition))
        return row

    def _events(self, mark: int) -> Sequence[Event]:
        self.record.update()
        return self.record.events[mark:]

    def _restore(self, fault: Fault) -> None:
        """Undo it, and what PHM was not allowed to recover: a new application container, as an operator would make it."""
        agent = self.stack.agent
        try:
            fault.clear(agent)
        except DockerException as error:  # it expects a container that runs
            self.console.print(f"  undo: {error}", markup=False)
        if not self._restored(fault):
            if agent.app.status == "paused":
                agent.app.unpause()
            self.stack.recreate("ros_app")
            put_back(agent)

    def _restored(self, fault: Fault) -> bool:
        """Whether the world is as before within RESTORED_LIMIT_S. False, too, if the fault cannot be observed so."""
        agent, mark = self.stack.agent, self.monitor.mark()
        if fault.restored(agent) is None:
            return False
        seen = self.record.wait(
            lambda event: event["event"] == "report" and bool(fault.restored(agent)), RESTORED_LIMIT_S, since=mark
        )
        return seen is not None


def _opens(event: Event, row: Row) -> bool:
    return bool(event["event"] == "fault_opened" and event["unit"] == row.unit)


def _fill(row: Row, events: Sequence[Event]) -> None:
    for event in events:
        if event["event"] == "fault_opened":
            row.alarm(event["unit"])
        elif event["event"] == "action" and event["phase"] == "started":
            row.actions.append(event["action"])


def judge_quiet(row: Row, events: Sequence[Event]) -> None:
    """Nothing was injected: no alarm is due, about the machine neither."""
    _fill(row, events)
    reports, alarms = sum(event["event"] == "report" for event in events), [*row.alarms, *row.beside]
    row.outcome = f"{reports} reports, {len(alarms)} alarms"
    if alarms:
        row.problems.append(f"alarms: {', '.join(alarms)}")


def judge_fault(row: Row, events: Sequence[Event], condition: str) -> None:
    """One alarm is due at each expected unit, and `condition` at the first of them."""
    _fill(row, events)
    seen = {event["condition"] for event in events if event.get("unit") == row.unit and event.get("condition")}
    row.outcome = ", ".join(sorted(seen)) or "not reported"
    if sorted(row.alarms) != sorted(row.expected):
        row.problems.append(f"alarms: {row.alarms or 'none'}, expected one at {' and '.join(row.expected)}")
    if condition not in seen:
        row.problems.append(f"known as {row.outcome}, expected {condition}")


def learned_counts(text: str) -> Mapping[str, int]:
    """How many nodes, topics and rates, devices and manifests a learned file has."""
    document = yaml.safe_load(text)
    ros, containers = document.get("ros") or {}, document["containers"]
    topics = ros.get("topics") or ()
    return {
        "nodes": len(ros.get("nodes") or ()),
        "topics": len(topics),
        "rates": sum("rate" in topic for topic in topics),
        "devices": sum(len(container.get("devices") or ()) for container in containers),
        "manifests": sum("manifest" in file for container in containers for file in container.get("files") or ()),
    }


def override(folder: Path) -> Path:
    """A Compose file that gives the sidecar this folder as /etc/phm."""
    file = folder / "compose.yaml"
    file.write_text(yaml.safe_dump({"services": {"phm": {"volumes": [f"{folder}:/etc/phm"]}}}), "utf-8")
    return file


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/proof-learned", description=__doc__)
    parser.add_argument("--for", dest="watch", default="60s", metavar="TIME", help="how long PHM learns (default: 60s)")
    parser.add_argument(
        "--clean", type=float, default=600.0, metavar="SECONDS", help="nothing is injected for so long (default: 600)"
    )
    parser.add_argument("--only", nargs="+", default=FAULTS, choices=FAULTS, metavar="FAULT", help="these faults alone")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--keep-logs", action="store_true", help="do not remove the log folder")
    chosen = parser.parse_args(arguments)
    console, faults = make_console(json=chosen.json), all_faults()
    folder = Path(tempfile.mkdtemp(prefix="phm-learned-"))
    folder.chmod(0o777)  # PHM is an ordinary user in its container
    config = write(BEFORE, folder / "phm.yaml")
    files = (*FILES, str(override(folder)))
    stack = Stack(project="phm-learned", interval_s=3.0, ground_port=0, extra={"PHM_CONFIG": str(config)}, files=files)
    run = LearnedRun(stack, console, folder)
    try:
        with console.status("starting the agent"):
            stack.up()
            run.monitor.wait_ok()
        with console.status(f"learning for {chosen.watch}"):
            counts = learned_counts(run.learn(chosen.watch))
        console.print(f"learned: {', '.join(f'{count} {what}' for what, count in counts.items())}", highlight=False)
        rows = [print_row(run.clean(chosen.clean), console)]
        rows += [print_row(run.play(faults[name]), console) for name in chosen.only]
    finally:
        stack.down(keep_logs=chosen.keep_logs)
        if not chosen.keep_logs:
            shutil.rmtree(folder, ignore_errors=True)
    if chosen.keep_logs:
        console.print(f"logs: {stack.logs}, configuration: {folder}")
    return print_rows(rows, console, json=chosen.json)


if __name__ == "__main__":
    sys.exit(main())
