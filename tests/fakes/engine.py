"""A Docker Engine under the control of tests: real HTTP/1.1 on a unix socket, with faults on demand.

with FakeEngine(tmp_path / "engine.sock") as fake:
    fake.containers["ros_app"] = container("ros_app", health="healthy", networks=["swarm"])
    engine = Engine(fake.url)
    fake.fault = Hang(route="/json")      # every request whose path contains /json
    fake.set("ros_app", status="exited", exit_code=137)      # changes state and emits the event `die`
"""

from __future__ import annotations

import collections
import hashlib
import socketserver
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from tests.fakes.engine_faults import DropStream, Fault
from tests.fakes.engine_http import Handler


def container(
    name: str,
    *,
    container_id: str = "",
    status: str = "running",
    exit_code: int = 0,
    health: str = "",
    networks: Sequence[str] | Mapping[str, str] = (),
    labels: Mapping[str, str] | None = None,
    mounts: Sequence[Mapping[str, Any]] = (),
    files: Mapping[str, bytes] | None = None,
    folders: Mapping[str, Path] | None = None,
    tars: Mapping[str, bytes] | None = None,
    **state: Any,
) -> dict[str, Any]:
    """A container as GET /containers/x/json returns it. `networks` maps names to ids (default ``id-of-NAME``);
    `files` maps paths to content, for the archive route; `folders` maps folders to real ones with real files, and `tars` paths
    in them to what is sent instead of their tar. Further keywords go into State.
    """
    given = networks if isinstance(networks, Mapping) else {network: f"id-of-{network}" for network in networks}
    inspect: dict[str, Any] = {
        "Id": container_id or hashlib.sha256(name.encode()).hexdigest(),
        "Name": f"/{name}",
        "RestartCount": 0,
        "State": {
            "Status": status,
            "ExitCode": exit_code,
            "OOMKilled": False,
            "Error": "",
            "Pid": 4242,
            "StartedAt": "2026-01-01T00:00:00.000000000Z",
            **state,
        },
        "Config": {"Labels": dict(labels or {}), "Hostname": name},
        "HostConfig": {"NetworkMode": "default", "RestartPolicy": {"Name": "no"}, "Devices": []},
        "NetworkSettings": {
            "Networks": {
                network: {"NetworkID": network_id, "IPAddress": f"10.9.0.{number}", "Aliases": [name]}
                for number, (network, network_id) in enumerate(given.items(), start=2)
            }
        },
        "Mounts": [dict(mount) for mount in mounts],
        "Image": f"image-of-{name}",
        "_files": dict(files or {}),
        "_modes": {},
        "_folders": dict(folders or {}),
        "_tars": dict(tars or {}),
    }
    if health:
        inspect["State"]["Health"] = {"Status": health, "FailingStreak": 0, "Log": []}
    return inspect


class Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True
    request_queue_size = 64
    fake: FakeEngine

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients may disconnect at any time; a defect of the fake is kept for debugging."""
        error = sys.exc_info()[1]
        if error is not None and not isinstance(error, ConnectionError):
            self.fake.errors.append(error)
            traceback.print_exception(error)


class FakeEngine:
    """See the module. `calls` has the last 1000 requests as ``METHOD /path``, without the version."""

    def __init__(self, path: Path | str, *, api: str = "1.41", minimum: str = "1.24") -> None:
        self.path, self.url = str(path), f"unix://{path}"
        self.api, self.minimum = api, minimum
        self.containers: dict[str, dict[str, Any]] = {}
        self.networks: dict[str, dict[str, Any]] = {}
        self.images: dict[str, dict[str, bytes]] = {}
        """Files by image, for containers that are made of it."""
        self.programs: collections.deque[dict[str, Any]] = collections.deque(maxlen=100)
        """What exec was asked to run, as created; `Started` once it was."""
        self.calls: collections.deque[str] = collections.deque(maxlen=1000)
        self.events: collections.deque[dict[str, Any]] = collections.deque(maxlen=256)
        self.errors: collections.deque[BaseException] = collections.deque(maxlen=100)
        self.archived: Callable[[str, str], None] = lambda method, name: None
        """Called with each request for a file of `folders`."""
        self.changed = threading.Condition()
        self.stopping = False
        self.clock_ahead_s = 0.0
        """How far the clock by which events are stamped is ahead of this machine's."""
        self.streams = 0
        self._fault: Fault | None = None
        self._sent = 0
        self._server: Server | None = None

    # ------------------------------------------------------------ for tests

    def __enter__(self) -> FakeEngine:
        Path(self.path).unlink(missing_ok=True)
        self.stopping = False
        self._server = Server(self.path, Handler)
        self._server.fake = self
        threading.Thread(target=self._server.serve_forever, args=(0.02,), name="fake-engine", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self.changed:
            self.stopping = True
            self.changed.notify_all()
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
        Path(self.path).unlink(missing_ok=True)

    @property
    def fault(self) -> Fault | None:
        return self._fault

    @fault.setter
    def fault(self, fault: Fault | None) -> None:
        with self.changed:
            self._fault = fault
            self.changed.notify_all()

    def emit(self, kind: str, action: str, actor: str = "", **attributes: str) -> None:
        """Send an event to all streams, e.g. ``emit("container", "die", id, name="ros_app", exitCode="1")``."""
        now = time.time_ns() + int(self.clock_ahead_s * 1e9)
        event = {
            "Type": kind,
            "Action": action,
            "Actor": {"ID": actor, "Attributes": attributes},
            "time": now // 10**9,
            "timeNano": now,
        }
        with self.changed:
            self.events.append(event)
            self._sent += 1
            self.changed.notify_all()

    def set(self, name: str, *, silently: bool = False, **state: Any) -> None:
        """Change a container's state: status=, exit_code=, health=. Emits the events of a real engine, unless `silently`."""
        entry = self.containers[name]
        action = ""
        if "status" in state:
            entry["State"]["Status"] = state["status"]
            action = {"running": "start", "exited": "die", "paused": "pause"}.get(state["status"], "")
            if action == "start":
                entry["State"]["StartedAt"] = f"2026-01-01T00:00:{time.monotonic_ns()}Z"
        if "exit_code" in state:
            entry["State"]["ExitCode"] = state["exit_code"]
        if "health" in state:
            entry["State"]["Health"] = {"Status": state["health"], "FailingStreak": 0, "Log": []}
            action = f"health_status: {state['health']}"
        if action and not silently:
            self.emit_for(name, action)

    def emit_for(self, name: str, action: str, **attributes: str) -> None:
        entry = self.containers[name]
        code = {"exitCode": str(entry["State"]["ExitCode"])} if action == "die" else {}
        self.emit("container", action, entry["Id"], name=name, **entry["Config"]["Labels"], **code, **attributes)

    def wait(self, condition: Callable[[FakeEngine], bool], timeout_s: float = 60.0) -> bool:
        """Wait until an activity of the engine makes `condition` true."""
        with self.changed:
            return self.changed.wait_for(lambda: condition(self), timeout_s)

    # ------------------------------------------------------------ for the handler

    def create(self, name: str, image: str, labels: Mapping[str, str] | None) -> dict[str, Any]:
        """Add a container of one of `images`, as the API does."""
        made = self.containers[name] = container(name, status="created", labels=labels, files=self.images[image])
        return made

    def find(self, ref: str) -> dict[str, Any] | None:
        for entry in self.containers.values():
            if ref in (entry["Id"], entry["Name"].lstrip("/")) or (len(ref) >= 12 and entry["Id"].startswith(ref)):
                return entry
        return None

    def following(self, since: int | None) -> Iterator[dict[str, Any]]:
        with self.changed:
            ready = [event for event in self.events if since is not None and event["timeNano"] >= since]
            seen = self._sent
            self.streams += 1
            self.changed.notify_all()
        try:
            while True:
                yield from ready
                with self.changed:
                    while self._sent == seen and not self._ended():
                        self.changed.wait()
                    if self._ended():
                        return
                    ready, seen = list(self.events)[seen - self._sent :], self._sent
        finally:
            with self.changed:
                self.streams -= 1
                self.changed.notify_all()

    def _ended(self) -> bool:
        return self.stopping or isinstance(self._fault, DropStream)
