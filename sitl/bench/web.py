"""What the page of `phm gcs --web` costs, and how soon it shows a frame: many agents at 1 Hz over loopback, one machine.

``scripts/bench web`` starts `phm gcs` with and without the page, sends the heartbeats of all agents (and of as many autopilots) evenly
spread over each second, and reads the live data as a browser does. The latency is from the send call to the moment when a client has
read the change of the agent's row: the time that the browser needs to draw it is not in it.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from phm.core.model import Level, Slot
from phm.transport.dialect import mavlink
from phm.wire import status_word
from sitl.harness.machine import machine

LIMIT_S = 60.0
WARM_S = 5.0
AT_ONCE, NEW_S = 250, 15
"""The senders that the ground accepts in a burst, and per second after that (`phm.gcs.ingress_filter`), with a margin."""
IDS = 250
HEALTHY = status_word.encode(dict.fromkeys(list(Slot)[:9], Level.OK))


@dataclass(frozen=True)
class Row:
    """Of one number of agents. cpu, cpu_table: percent of a core, with the page and without. p50_s, p95_s: from frame to client."""

    agents: int
    clients: int
    cpu: float
    cpu_table: float
    memory_mb: float
    p50_s: float
    p95_s: float
    most_s: float
    changes: int
    kb_s: float


class Sender(threading.Thread):
    """Sends a heartbeat of each agent and of its autopilot every second; remembers when."""

    def __init__(self, agents: int, port: int) -> None:
        super().__init__(daemon=True)
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to, self._ending = ("127.0.0.1", port), threading.Event()
        self._senders = [
            (name, mavlink.MAVLink(None, number, component), mavlink.MAVLink(None, number, 1))
            for name, number, component in map(_ids, range(agents))
        ]
        self.sent: dict[str, float] = {}

    def run(self) -> None:
        begin, turn = time.monotonic(), 0
        while not self._ending.is_set():
            for place, (name, phm, autopilot) in enumerate(self._senders):
                self._ending.wait(max(0.0, begin + turn + place / len(self._senders) - time.monotonic()))
                self._sock.sendto(_beat(autopilot, 2, 3, 0), self._to)
                self.sent[name] = time.monotonic()
                self._sock.sendto(_beat(phm, 18, 8, HEALTHY), self._to)
            turn += 1

    def end(self) -> None:
        self._ending.set()
        self.join()
        self._sock.close()


class Reader(threading.Thread):
    """A client of the live data. waits: seconds from frame to here."""

    def __init__(self, port: int, sender: Sender) -> None:
        super().__init__(daemon=True)
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
        self._sender = sender
        self.waits: list[float] = []
        self.bytes, self.agents, self.counts = 0, 0, False

    def run(self) -> None:
        with contextlib.suppress(OSError, ValueError, AttributeError, http.client.HTTPException):
            self._connection.request("GET", "/api/live")
            kind = b""
            for line in self._connection.getresponse():
                now = time.monotonic()
                self.bytes += len(line)
                name, _, value = line.rstrip().partition(b": ")
                kind = value if name == b"event" else kind
                if name == b"data" and kind in (b"full", b"delta"):
                    self._take(kind, json.loads(value), now)

    def _take(self, kind: bytes, body: dict[str, Any], now: float) -> None:
        rows = body.get("agents", {})
        self.agents = len(rows) if kind == b"full" else max(self.agents, len(rows))
        if kind == b"delta" and self.counts:
            self.waits += [now - self._sender.sent[name] for name, row in rows.items() if row and "at" in row]

    def end(self) -> None:
        if self._connection.sock is not None:
            with contextlib.suppress(OSError):
                self._connection.sock.shutdown(socket.SHUT_RDWR)
        self.join(LIMIT_S)


def measure(agents: int, clients: int, seconds: float) -> Row:
    table = _run(agents, 0, seconds)[0]
    cpu, memory, readers = _run(agents, clients, seconds)
    waits = sorted(wait for reader in readers for wait in reader.waits)
    received = sum(reader.bytes for reader in readers) / len(readers) / (seconds + WARM_S) / 1000
    return Row(
        agents,
        clients,
        cpu,
        table,
        memory,
        waits[len(waits) // 2],
        waits[int(0.95 * len(waits))],
        waits[-1],
        len(waits) // clients,
        received,
    )


def _run(agents: int, clients: int, seconds: float) -> tuple[float, float, list[Reader]]:
    """CPU in percent of a core and memory in MB of `phm gcs`, and its clients; 0 clients: without the page."""
    with tempfile.TemporaryDirectory() as folder, _gcs(Path(folder), page=clients > 0) as (process, port, web):
        sender = Sender(agents, port)
        sender.start()
        readers = [Reader(web, sender) for _ in range(clients)]
        try:
            time.sleep(WARM_S + max(0, 2 * agents - AT_ONCE) / NEW_S)
            for reader in readers:
                reader.start()
            time.sleep(WARM_S)
            for reader in readers:
                if reader.agents < agents:
                    raise SystemExit(f"a client has {reader.agents} of {agents} agents")
                reader.counts = True
            before, began = process.cpu_times(), time.monotonic()
            time.sleep(seconds)
            after, took = process.cpu_times(), time.monotonic() - began
            memory = process.memory_info().rss / 1e6
        finally:
            sender.end()
            for reader in readers:
                reader.end()
        cpu = 100 * (after.user + after.system - before.user - before.system) / took
        return cpu, memory, readers


@contextlib.contextmanager
def _gcs(folder: Path, *, page: bool) -> Iterator[tuple[psutil.Process, int, int]]:
    port, web = _free_port(socket.SOCK_DGRAM), _free_port(socket.SOCK_STREAM)
    command = [sys.executable, "-m", "phm.cli", "gcs", f"udpin:127.0.0.1:{port}"]
    command += ["--web", str(web), "--history", str(folder / "history.db")] if page else []
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as gcs:
        try:
            _until_open(web if page else None, gcs)
            yield psutil.Process(gcs.pid), port, web
        finally:
            gcs.terminate()
            gcs.communicate(timeout=LIMIT_S)


def _until_open(web: int | None, gcs: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + LIMIT_S
    while gcs.poll() is None and time.monotonic() < end:
        with contextlib.suppress(OSError):
            if web is not None:
                socket.create_connection(("127.0.0.1", web), 1).close()
                return
        time.sleep(0.2)
        if web is None:
            return
    raise SystemExit("phm gcs did not start")


def _free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def _ids(place: int) -> tuple[str, int, int]:
    """Name, system and component: MAVLink has ids for 250 agents, more are told apart by their component."""
    number, component = place % IDS + 1, 193 + place // IDS
    return f"A{number:02d}{'' if component == 193 else f'/{component}'}", number, component


def _beat(sender: Any, kind: int, autopilot: int, custom_mode: int) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, custom_mode, 4, 3)
    packed: bytes = message.pack(sender)
    sender.seq = (sender.seq + 1) % 256
    return packed


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="scripts/bench web", description=__doc__)
    parser.add_argument("--agents", type=int, nargs="+", default=[100, 300])
    parser.add_argument("--clients", type=int, default=2, help="open pages (2)")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement (30)")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    rows = [measure(agents, given.clients, given.seconds) for agents in given.agents]
    if given.json:
        print(json.dumps({"machine": machine(), "rows": [asdict(row) for row in rows]}, indent=2))
        return
    table = Table(title=f"phm gcs --web, {given.clients} clients ({machine()})")
    for head in ("agents", "CPU with page", "without", "memory", "p50", "p95", "max", "KB/s a client"):
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(
            str(row.agents),
            f"{row.cpu:.1f} %",
            f"{row.cpu_table:.1f} %",
            f"{row.memory_mb:.0f} MB",
            f"{row.p50_s:.3f} s",
            f"{row.p95_s:.3f} s",
            f"{row.most_s:.3f} s",
            f"{row.kb_s:.1f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
