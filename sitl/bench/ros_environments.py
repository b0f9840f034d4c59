"""In which ROS environments PHM sees an application: real nodes and a real `phm run`, in network namespaces like two containers.

``python -m sitl.bench.ros_environments`` measures all cases, or those whose name contains a given word (``host/local``); 20 minutes, as root.
A case is three nodes without beacons, each a process that publishes 10 Hz; PHM without an engine. It counts what PHM
sees, then kills a node and waits for the report. ``--markdown FILE...`` writes the table of docs/reference/ros.md from earlier ``--json`` output.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sitl.bench.ros_environment_rows import (
    BEGIN,
    DISCOVERIES,
    END,
    PORT,
    Case,
    Row,
    as_json,
    cases,
    from_json,
    markdown,
)
from sitl.harness.compose_stack import ROOT
from sitl.harness.log_follower import Event, Record
from sitl.harness.machine import machine

NODES = 3
SEE_S, MORE_S = 90.0, 5.0
"""How long PHM may take to see all nodes and all data, on a busy machine; and after it has reported that a node is not there."""
STEADY_S = 5.0
"""Between that and the kill: the sampler learns how regular the topics are."""
REPORT_S = 40.0
NEEDED = frozenset({"PATH", "HOME", "LANG"})
VENVS = {"jazzy": ".venv", "kilted": ".venv-kilted"}
_numbers = itertools.count()


class Hosts:
    """Two network namespaces with a cable between them, and a /dev/shm for each side, or one for both.

    On a bridge network the application is in the first and PHM in the second; on the host's network both are in the first.
    """

    def __init__(self, memory: Path, *, bridge: bool, shared_ipc: bool, multicast: bool) -> None:
        number = next(_numbers)
        self._names = [f"phm-{os.getpid()}-{number}-{side}" for side in "ab"]
        self.address = {"app": "10.77.0.1", "phm": "10.77.0.2" if bridge else "127.0.0.1"}
        if not bridge:
            self.address["app"] = "127.0.0.1"
        self._place = {"app": self._names[0], "phm": self._names[bridge]}
        self._memory = {"app": memory / "app", "phm": memory / ("app" if shared_ipc else "phm")}
        for path in self._memory.values():
            path.mkdir(exist_ok=True)
        try:
            self._make(multicast=multicast)
        except BaseException:
            self.close()
            raise

    def _make(self, *, multicast: bool) -> None:
        for name in self._names:
            _call("ip", "netns", "add", name)
        first, second = self._names
        _call("ip", "-n", first, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", second)
        for number, name in enumerate(self._names, 1):
            for device in ("lo", "eth0"):
                _call("ip", "-n", name, "link", "set", device, "up")
            _call("ip", "-n", name, "address", "add", f"10.77.0.{number}/24", "dev", "eth0")
            if not multicast:
                _call("ip", "netns", "exec", name, "iptables", "-A", "OUTPUT", "-d", "224.0.0.0/4", "-j", "DROP")

    def start(
        self, side: str, command: Sequence[str], environ: Mapping[str, str], log: Path
    ) -> subprocess.Popen[bytes]:
        """A process on one side ("app" or "phm"); its process id is that of the command itself."""
        script = 'mount --bind "$1" /dev/shm && shift && exec "$@"'
        inside = ("unshare", "--mount", "--ipc", "sh", "-c", script, "sh", str(self._memory[side]), *command)
        with log.open("ab") as output:
            return subprocess.Popen(
                ("ip", "netns", "exec", self._place[side], *inside),
                env={**{name: os.environ[name] for name in NEEDED if name in os.environ}, **environ},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def close(self) -> None:
        for name in self._names:
            subprocess.run(("ip", "netns", "delete", name), check=False, capture_output=True)


def measure(case: Case) -> Row:
    """One case, from nothing to the report of the killed node. Raises RuntimeError where it cannot be set up."""
    how = DISCOVERIES[case.discovery]
    with contextlib.ExitStack() as end:
        folder = Path(end.enter_context(tempfile.TemporaryDirectory(prefix="phm-env-")))
        memory = Path(end.enter_context(tempfile.TemporaryDirectory(prefix="phm-env-", dir="/dev/shm")))
        hosts = Hosts(memory, bridge=case.network == "bridge", shared_ipc=how.shared_ipc, multicast=how.multicast)
        end.callback(hosts.close)
        app = {name: value.format(**hosts.address) for name, value in how.app.items()}
        phm = {name: value.format(**hosts.address) for name, value in how.phm.items()}
        if case.profile == "shipped":
            profile = str(ROOT / "config" / "fastdds.xml")
            app |= {"FASTRTPS_DEFAULT_PROFILES_FILE": profile, "FASTDDS_DEFAULT_PROFILES_FILE": profile}
        programs = ROOT / VENVS[case.distro] / "bin"
        running: list[subprocess.Popen[bytes]] = []
        if how.server:
            serving = hosts.start(
                "app", server_command(programs, hosts.address["app"], PORT), {}, folder / "server.log"
            )
            end.callback(_end, serving)
            running.append(serving)
        nodes: list[subprocess.Popen[bytes]] = []
        for number in range(1, NODES + 1):
            nodes.append(hosts.start("app", _node(programs, number), _environ(app), folder / "app.log"))
            end.callback(_end, nodes[-1])
        _configure(folder)
        daemon = (str(programs / "python"), "-m", "phm.cli", "run", "-c", str(folder / "phm.yaml"))
        process = hosts.start("phm", daemon, _environ(phm), folder / "phm.log")
        end.callback(_end, process)
        row = _watch(case, Record(folder / "log" / "phm.jsonl"), nodes[0])
        if any(one.poll() is not None for one in (*running, *nodes[1:], process)):
            output = "".join(file.read_text(errors="replace")[-1000:] for file in sorted(folder.glob("*.log")))
            raise RuntimeError(f"{case.name}: a process ended by itself: {output}")
        return row


def _watch(case: Case, record: Record, victim: subprocess.Popen[bytes]) -> Row:
    began = time.monotonic()
    until = began + SEE_S
    row = Row(case, of=NODES)
    while time.monotonic() < until:
        record.update()
        levels = _levels(record.events)
        row.nodes = sum(level == "OK" for unit, level in levels.items() if unit.startswith("nodes/"))
        row.rates = sum(level == "OK" for unit, level in levels.items() if unit.startswith("rates/"))
        if row.nodes == row.rates == NODES:
            row.seen_s = round(time.monotonic() - began, 1)
            break
        if any(event["event"] == "fault_opened" for event in record.events):
            until = min(until, time.monotonic() + MORE_S)
        time.sleep(0.1)
    faults = [event for event in record.events if event["event"] == "fault_opened"]
    row.conditions = sorted({str(event.get("condition")) for event in faults})
    if row.nodes < NODES:
        return row
    time.sleep(STEADY_S)
    record.update()
    known = len(record.events)
    killed = time.monotonic()
    victim.kill()
    event = record.wait(lambda found: found["event"] == "fault_opened" and _of_victim(found), REPORT_S, since=known)
    if event is not None:
        row.killed_s, row.reported = round(event["mono"] - killed, 1), event["unit"]
    return row


def _levels(events: Sequence[Event]) -> dict[str, str]:
    return {event["unit"]: event["level"] for event in events if event["event"] in ("unit", "transition")}


def _of_victim(event: Event) -> bool:
    return str(event["unit"]).endswith(("/node_1", "/topic_1"))


def _node(programs: Path, number: int) -> tuple[str, ...]:
    name = ("--name", f"node_{number}", "--namespace", "/a")
    return (
        str(programs / "python"),
        "-m",
        "sitl.application.node",
        *name,
        "--publish",
        f"topic_{number}:10",
        "--no-beacon",
    )


def server_command(programs: Path, address: str, port: int) -> tuple[str, ...]:
    """A Fast DDS discovery server, started by the environment's Python, which knows where the wheels have their libraries.

    programs: the folder `bin` of the environment.
    """
    start = "import os, sys; os.execv(sys.argv[1], sys.argv[1:])"
    program = str(programs / "fast-discovery-server")
    # Fast DDS 3 wants the number of a command first: 42, serve.
    command = ("42",) if any((programs.parent / "lib").glob("libfastdds.so*")) else ()
    return (str(programs / "python"), "-c", start, program, *command, "-i", "0", "-l", address, "-p", str(port))


def _configure(folder: Path) -> None:
    """JSON is YAML."""
    numbers = range(1, NODES + 1)
    topics = [{"name": f"/a/topic_{n}", "rate": "10Hz", "publishers": [f"/a/node_{n}"]} for n in numbers]
    settings = {
        "agent": {"name": "a", "id": 1},
        "ros": {"nodes": [{"name": f"/a/node_{n}"} for n in numbers], "topics": topics},
        "log": {"directory": str(folder / "log")},
        "state_dir": str(folder / "state"),
        "run_dir": str(folder / "run"),
        "recovery": {"mode": "off"},
        # A busy machine would be named as the cause instead of the killed node.
        "checks": {"engine": {"enabled": False}, "host": {"enabled": False}},
    }
    for name in ("log", "state", "run"):
        (folder / name).mkdir()
    (folder / "phm.yaml").write_text(json.dumps(settings), "utf-8")


def _environ(variables: Mapping[str, str]) -> dict[str, str]:
    return {"PYTHONPATH": f"{ROOT}:{ROOT / 'checks'}", "ROS_DOMAIN_ID": "0", **variables}


def _call(*command: str) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()} (network namespaces need root)")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def run(chosen: Sequence[Case], jobs: int) -> Iterator[Row]:
    """All cases, `jobs` at a time; each row is printed to standard error as it comes."""
    with ThreadPoolExecutor(jobs) as pool:
        for row in pool.map(measure, chosen):
            print(f"{row.case.name}: {row.cell} {row.reported} {' '.join(row.conditions)}".rstrip(), file=sys.stderr)
            yield row


def write(files: Sequence[Path], page: Path) -> None:
    """Put the table of these measurements between the markers of the page; a later file replaces rows of an earlier one."""
    found: dict[Case, Row] = {}
    for file in files:
        found.update({row.case: row for row in from_json(file)[1]})
    before, _, rest = page.read_text("utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n{markdown(list(found.values()))}\n{END}{after}", "utf-8")


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m sitl.bench.ros_environments", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("only", nargs="*", help="words of the names of cases, such as host/local/none/jazzy")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows to this file")
    parser.add_argument(
        "--markdown", type=Path, nargs="+", metavar="FILE", help="write the table of docs/reference/ros.md"
    )
    chosen = parser.parse_args(argv)
    if chosen.markdown:
        write(chosen.markdown, ROOT / "docs" / "reference" / "ros.md")
        return 0
    rows = list(run(list(cases(chosen.only)), chosen.jobs))
    if chosen.json:
        chosen.json.write_text(as_json(rows, machine()), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
