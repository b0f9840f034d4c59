"""A Zenoh router and a reader of a fleet, for tests and `scripts/bench fleet`: `python -m sitl.simulation.fleet_router
SESSIONS OPTIONS`.

The router is a session in mode router: the same Rust code as the program `zenohd`, without its plug-ins. It runs until
its standard input ends, without multicast discovery.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from phm.wire.fleet_status import FleetStatus, decode

START_LIMIT_S = 60.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def config(mode: str, **options: Any) -> Any:
    """A `zenoh.Config`. Options by their path in Zenoh's configuration, with `__` for `/`."""
    made = zenoh.Config()
    common = {
        "mode": mode,
        "scouting__multicast__enabled": False,
        "scouting__gossip__enabled": False,
        "transport__shared_memory__enabled": False,
    }
    for path, value in {**common, **options}.items():
        made.insert_json5(path.replace("__", "/"), json.dumps(value))
    return made


class Router:
    """The router in a separate process, on loopback. A new one may use the same port after `kill`."""

    def __init__(self, port: int, sessions: int = 1000, **options: Any) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port}"
        chosen = {"listen__endpoints": [self.endpoint], **options}
        words = (sys.executable, "-m", "sitl.simulation.fleet_router", str(sessions), json.dumps(chosen))
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        if self.process.stdout.readline() != "ready\n":
            raise RuntimeError(f"the router on {self.endpoint} did not start")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


class Ground:
    """Reads a fleet like any client: subscribes, queries the present state once, and monitors the tokens.

    statuses: the newest by agent. tokens: agent and boot id of those present. times: of each event, on the monotonic
    clock.
    """

    def __init__(self, endpoint: str, fleet: str, on_status: Callable[[FleetStatus], None] | None = None) -> None:
        self.statuses: dict[str, FleetStatus] = {}
        self.bytes: dict[str, int] = {}
        self.tokens: dict[tuple[str, str], float] = {}
        self.gone: dict[tuple[str, str], float] = {}
        self.messages = self.payload_bytes = self.refused = 0
        self._fleet, self._on_status = fleet, on_status
        self._lock = threading.Lock()
        self.session = zenoh.open(
            config("client", connect__endpoints=[endpoint], connect__timeout_ms=int(START_LIMIT_S * 1000))
        )
        self.session.declare_subscriber(f"phm/{fleet}/*/status", self._take)
        self.session.liveliness().declare_subscriber(f"phm/{fleet}/*/alive/*", self._token, history=True)
        self.ask()

    def ask(self) -> None:
        """Query what was published before this reader connected; each agent answers."""
        self.session.get(f"phm/{self._fleet}/*/status", self._reply, timeout=START_LIMIT_S)

    def wait(self, done: Callable[[Ground], bool], limit_s: float = 120.0) -> float:
        """Poll until `done`; return how long that took. Raises TimeoutError with the known state."""
        began = time.monotonic()
        while not done(self):
            if time.monotonic() - began > limit_s:
                raise TimeoutError(
                    f"not within {limit_s:g} s: {len(self.statuses)} statuses, tokens {list(self.tokens)[:5]}"
                )
            time.sleep(0.005)
        return time.monotonic() - began

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]

    def _take(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        try:
            status = decode(payload)
        except ValueError:
            self.refused += 1
            return
        with self._lock:
            self.messages += 1
            self.payload_bytes += len(payload)
            known = self.statuses.get(status.agent)
            # The answer to a query may be older than a publication that arrived meanwhile.
            if known is None or known.boot_id != status.boot_id or known.sequence < status.sequence:
                self.statuses[status.agent] = status
        if self._on_status is not None:
            self._on_status(status)

    def _reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok)

    def _token(self, sample: zenoh.Sample) -> None:
        agent, _, boot = str(sample.key_expr).split("/")[2:5]
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self.tokens[agent, boot] = time.monotonic()
            elif self.tokens.pop((agent, boot), None) is not None:
                self.gone[agent, boot] = time.monotonic()


def serve(sessions: int, options: Mapping[str, Any]) -> None:
    """The router's process. sessions: Zenoh's own limit is 1000, of agents and readers together."""
    chosen = {
        "transport__unicast__max_sessions": sessions,
        "transport__unicast__accept_pending": 1000,
    }
    with zenoh.open(config("router", **chosen, **options)):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    serve(int(sys.argv[1]), json.loads(sys.argv[2]))
