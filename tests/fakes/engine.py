"""A Docker Engine that tests command: real HTTP/1.1 on a unix socket, with faults on demand.

with FakeEngine(tmp_path / "engine.sock") as fake:
    fake.containers["ros_app"] = container("ros_app", health="healthy", networks=["swarm"])
    engine = Engine(fake.url)
    fake.fault = Hang(route="/json")      # every request whose path contains /json
    fake.set("ros_app", status="exited", exit_code=137)      # changes state and emits the event `die`
"""

from __future__ import annotations

import base64
import collections
import contextlib
import hashlib
import io
import json
import re
import socketserver
import sys
import tarfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

PATIENCE_S = 60.0
"""After this a hanging or trickling answer ends, so that a test that forgot its deadline fails instead of hanging."""


@dataclass(frozen=True)
class Fault:
    """Base of all faults; `route` limits it to requests whose path contains that text."""

    route: str = ""


@dataclass(frozen=True)
class Hang(Fault):
    """Take the request and never answer."""


@dataclass(frozen=True)
class Trickle(Fault):
    """Answer with the right bytes, one every `every_s` seconds; `endless` pads so that it takes a minute."""

    every_s: float = 0.05
    endless: bool = True


@dataclass(frozen=True)
class Status(Fault):
    code: int = 500
    message: str = "injected"

    def __init__(self, code: int = 500, message: str = "injected", route: str = "") -> None:
        object.__setattr__(self, "code", code)
        object.__setattr__(self, "message", message)
        object.__setattr__(self, "route", route)


@dataclass(frozen=True)
class Garbage(Fault):
    """HTTP, but no JSON."""


@dataclass(frozen=True)
class NoHttp(Fault):
    """Something else than HTTP."""


@dataclass(frozen=True)
class Truncate(Fault):
    """Close the connection in the middle of the body."""


@dataclass(frozen=True)
class Oversize(Fault):
    """A JSON answer of `size` bytes, in pieces."""

    size: int = 64 << 20


@dataclass(frozen=True)
class DropStream(Fault):
    """Event streams end at once: those that are open and those that are opened while it lasts."""


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
    **state: Any,
) -> dict[str, Any]:
    """A container as GET /containers/x/json shows it. `networks` maps names to ids (default ``id-of-NAME``);
    `files` maps paths to content, for the archive route; further keywords go into State.
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
    }
    if health:
        inspect["State"]["Health"] = {"Status": health, "FailingStreak": 0, "Log": []}
    return inspect


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True
    request_queue_size = 64
    fake: FakeEngine

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients that hang up are part of the game; a defect of the fake is kept for whoever wonders."""
        error = sys.exc_info()[1]
        if error is not None and not isinstance(error, ConnectionError):
            self.fake.errors.append(error)
            traceback.print_exception(error)


class FakeEngine:
    """See the module. `calls` holds the last 1000 requests as ``METHOD /path``, without the version."""

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
        self.changed = threading.Condition()
        self.stopping = False
        self.clock_ahead_s = 0.0
        """How far the clock by which events are stamped is ahead of this machine's."""
        self.streams = 0
        self._fault: Fault | None = None
        self._sent = 0
        self._server: _Server | None = None

    # ------------------------------------------------------------ for tests

    def __enter__(self) -> FakeEngine:
        Path(self.path).unlink(missing_ok=True)
        self.stopping = False
        self._server = _Server(self.path, _Handler)
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
        """Change a container's state: status=, exit_code=, health=. Emits what the engine would, unless `silently`."""
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

    def wait(self, condition: Callable[[FakeEngine], bool], timeout_s: float = 10.0) -> bool:
        """Until something that the engine does makes `condition` true."""
        with self.changed:
            return self.changed.wait_for(lambda: condition(self), timeout_s)

    # ------------------------------------------------------------ for the handler

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


def _nanoseconds(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 10**9 + int(fraction.ljust(9, "0")[:9])


class _Refusal(Exception):
    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def setup(self) -> None:
        super().setup()
        self.fake = self.server.fake
        self.trickle: Trickle | None = None

    def address_string(self) -> str:
        return "unix"

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet: `calls` is the log."""

    def do_GET(self) -> None:
        self._serve()

    do_HEAD = do_POST = do_PUT = do_DELETE = do_GET

    def _serve(self) -> None:
        fake = self.fake
        url = urlsplit(self.path)
        self.route = re.sub(r"^/v[0-9.]+", "", unquote(url.path))
        self.query = {key: values[0] for key, values in parse_qs(url.query).items()}
        length = int(self.headers.get("Content-Length") or 0)
        self.raw = self.rfile.read(length) if length else b""
        self.body = json.loads(self.raw or b"{}") if self.command != "PUT" else {}
        with fake.changed:
            fake.calls.append(f"{self.command} {self.route}")
            fake.changed.notify_all()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            if self._broken():
                return
            try:
                self._answer()
            except _Refusal as refusal:
                self._json({"message": str(refusal)}, refusal.code)

    # ------------------------------------------------------------ faults

    def _broken(self) -> bool:
        """Whether the fault that is set took the request; Trickle only changes how bytes are sent."""
        fault = self.fake.fault
        self.trickle = None
        if fault is None or fault.route not in self.route:
            return False
        self.close_connection = True
        if isinstance(fault, Hang):
            with self.fake.changed:
                self.fake.changed.wait_for(lambda: self.fake.fault is not fault or self.fake.stopping, PATIENCE_S)
        elif isinstance(fault, Status):
            self._json({"message": fault.message}, fault.code)
        elif isinstance(fault, Garbage):
            self._send(200, b"<html>not what you asked for</html>", {"Content-Type": "text/html"})
        elif isinstance(fault, NoHttp):
            self.wfile.write(b"SSH-2.0-OpenSSH_9.2\r\n\r\n")
        elif isinstance(fault, Truncate):
            self.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"Id": "')
        elif isinstance(fault, Oversize):
            self._oversize(fault.size)
        elif isinstance(fault, Trickle):
            self.trickle = fault
            return False
        else:
            return False
        return True

    def _oversize(self, size: int) -> None:
        self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nConnection: close\r\n\r\n[")
        for _ in range(size >> 16):
            self.wfile.write(b" " * (1 << 16))
        self.wfile.write(b"]")

    def _write(self, data: bytes) -> None:
        if self.trickle is None:
            self.wfile.write(data)
            return
        until = time.monotonic() + PATIENCE_S
        for byte in data:
            self.wfile.write(bytes([byte]))
            time.sleep(self.trickle.every_s)
            if time.monotonic() > until or self.fake.stopping:
                return

    # ------------------------------------------------------------ answers

    def _send(self, code: int, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        if self.trickle is not None and self.trickle.endless:
            body += b" " * int(PATIENCE_S / self.trickle.every_s)
        lines = [f"HTTP/1.1 {code} X", f"Content-Length: {len(body)}", "Api-Version: " + self.fake.api]
        lines += [f"{key}: {value}" for key, value in (headers or {}).items()]
        head = ("\r\n".join(lines) + "\r\n\r\n").encode()
        self._write(head if self.command == "HEAD" else head + body)
        self.close_connection = self.close_connection or self.headers.get("Connection", "").lower() == "close"

    def _json(self, value: Any, code: int = 200) -> None:
        self._send(code, json.dumps(value).encode(), {"Content-Type": "application/json"})

    def _answer(self) -> None:
        for method, pattern, handler in _ROUTES:
            match = re.fullmatch(pattern, self.route)
            if match and method in (self.command, "*"):
                handler(self, *match.groups())
                return
        raise _Refusal(404, f"page not found: {self.command} {self.route}")

    def _container(self, ref: str) -> dict[str, Any]:
        entry = self.fake.find(ref)
        if entry is None:
            raise _Refusal(404, f"No such container: {ref}")
        return entry

    def _network(self, ref: str) -> tuple[str, str]:
        """Name and id; a network exists when it is in `networks` or a container is on it."""
        known = {name: str(entry.get("Id", f"id-of-{name}")) for name, entry in self.fake.networks.items()}
        for entry in self.fake.containers.values():
            for name, attached in entry["NetworkSettings"]["Networks"].items():
                known.setdefault(name, attached["NetworkID"])
        for name, network_id in known.items():
            if ref in (name, network_id):
                return name, network_id
        raise _Refusal(404, f"network {ref} not found")

    def ping(self) -> None:
        self._send(200, b"OK")

    def version(self) -> None:
        self._json({"Version": "20.10.24", "ApiVersion": self.fake.api, "MinAPIVersion": self.fake.minimum})

    def list(self) -> None:
        wanted = json.loads(self.query.get("filters", "{}")).get("label", [])
        found = []
        for entry in list(self.fake.containers.values()):
            labels = entry["Config"]["Labels"]
            if all(label in labels or label in [f"{k}={v}" for k, v in labels.items()] for label in wanted):
                found.append(
                    {"Id": entry["Id"], "Names": [entry["Name"]], "Labels": labels, "State": entry["State"]["Status"]}
                )
        self._json(found)

    def inspect(self, ref: str) -> None:
        self._json({key: value for key, value in self._container(ref).items() if not key.startswith("_")})

    def top(self, ref: str) -> None:
        if self._container(ref)["State"]["Status"] != "running":
            raise _Refusal(409, f"Container {ref} is not running")
        running = [["1", " ".join(one["Cmd"])] for one in self.fake.programs if one["Container"] == ref]
        self._json({"Titles": ["PID", "CMD"], "Processes": [["4242", "sleep"], *running]})

    def archive(self, ref: str) -> None:
        path, content = self.query.get("path", ""), b""
        entry = self._container(ref)
        files = entry["_files"]
        if self.command == "PUT":
            self._put(entry, path)
            return
        if self.command == "HEAD" and any(known.startswith(f"{path}/") for known in files):
            self._send(200, b"", {"X-Docker-Container-Path-Stat": _stat(Path(path).name, 0, 1 << 31 | 0o755)})
            return
        if path not in files:
            raise _Refusal(404, f"Could not find the file {path} in container {ref}")
        content, name, mode = files[path], Path(path).name, entry["_modes"].get(path, 0o644)
        tar = io.BytesIO()
        with tarfile.open(fileobj=tar, mode="w") as archive:
            member = tarfile.TarInfo(name)
            member.size, member.mode = len(content), mode
            archive.addfile(member, io.BytesIO(content))
        header = _stat(name, len(content), mode)
        self._send(200, tar.getvalue(), {"X-Docker-Container-Path-Stat": header, "Content-Type": "application/x-tar"})

    def _put(self, entry: dict[str, Any], folder: str) -> None:
        with tarfile.open(fileobj=io.BytesIO(self.raw)) as archive:
            for member in archive.getmembers():
                content = archive.extractfile(member)
                assert content is not None
                path = f"{folder.rstrip('/')}/{member.name}"
                entry["_files"][path], entry["_modes"][path] = content.read(), member.mode
        self._send(200, b"")

    def create(self) -> None:
        name, image = self.query.get("name", "nameless"), self.body["Image"]
        if image not in self.fake.images:
            raise _Refusal(404, f"No such image: {image}")
        if self.fake.find(name) is not None:
            raise _Refusal(409, f"The container name {name} is already in use")
        made = container(name, status="created", labels=self.body.get("Labels"), files=self.fake.images[image])
        self.fake.containers[name] = made
        self._json({"Id": made["Id"], "Warnings": []}, 201)

    def remove(self, ref: str) -> None:
        del self.fake.containers[self._container(ref)["Name"].lstrip("/")]
        self._send(204, b"")

    def exec_create(self, ref: str) -> None:
        if self._container(ref)["State"]["Status"] != "running":
            raise _Refusal(409, f"Container {ref} is not running")
        self.fake.programs.append({"Container": ref, "Started": False, **self.body})
        self._json({"Id": str(len(self.fake.programs) - 1)}, 201)

    def exec_start(self, number: str) -> None:
        self.fake.programs[int(number)].update(Started=True, Detach=self.body["Detach"])
        self._send(200, b"")

    def events(self) -> None:
        since = self.query.get("since")
        filters = json.loads(self.query.get("filters", "{}"))
        self.close_connection = True
        self._write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n")
        for event in self.fake.following(_nanoseconds(since) if since else None):
            action = event["Action"]
            if event["Type"] not in filters.get("type", [event["Type"]]):
                continue
            if not any(action.startswith(wanted) for wanted in filters.get("event", [""])):
                continue
            line = json.dumps(event).encode() + b"\n"
            self._write(b"%x\r\n%s\r\n" % (len(line), line))
        self._write(b"0\r\n\r\n")

    def act(self, ref: str, verb: str) -> None:
        entry = self._container(ref)
        name, status = entry["Name"].lstrip("/"), entry["State"]["Status"]
        if verb == "unpause" and status != "paused":
            raise _Refusal(409, f"Container {ref} is not paused")
        if verb == "start" and status == "running":
            self._send(304, b"")
            return
        if verb in ("restart", "stop", "kill") and status == "running":
            self.fake.set(name, status="exited", exit_code=137 if verb == "kill" else 143)
        if verb in ("restart", "start", "unpause"):
            self.fake.set(name, status="running", exit_code=0)
        if verb == "pause":
            self.fake.set(name, status="paused")
        self._send(204, b"")

    def network(self, ref: str) -> None:
        name, network_id = self._network(ref)
        self._json({"Name": name, "Id": network_id, "Driver": "bridge", "Containers": {}})

    def connect(self, ref: str, verb: str) -> None:
        name, network_id = self._network(ref)
        entry = self._container(self.body.get("Container", ""))
        networks = entry["NetworkSettings"]["Networks"]
        if verb == "disconnect":
            if networks.pop(name, None) is None:
                raise _Refusal(500, f"container is not connected to network {name}")
            self.fake.networks.setdefault(name, {"Id": network_id})
        elif name in networks:
            raise _Refusal(403, f"endpoint with name {entry['Name'][1:]} already exists in network {name}")
        else:
            given = self.body.get("EndpointConfig") or {}
            fixed = (given.get("IPAMConfig") or {}).get("IPv4Address")
            networks[name] = {
                "NetworkID": network_id,
                "IPAddress": fixed or "10.9.0.99",
                "Aliases": given.get("Aliases"),
                "IPAMConfig": {"IPv4Address": fixed} if fixed else None,
            }
        self.fake.emit("network", verb, network_id, name=name, container=entry["Id"], type="bridge")
        self._send(200, b"")


def _stat(name: str, size: int, mode: int) -> str:
    """The header that describes a path."""
    stat = {"name": name, "size": size, "mode": mode, "mtime": "2026-01-01T00:00:00Z", "linkTarget": ""}
    return base64.b64encode(json.dumps(stat).encode()).decode()


_REF = r"([^/]+)"
_ROUTES: list[tuple[str, str, Callable[..., None]]] = [
    ("*", "/_ping", _Handler.ping),
    ("GET", "/version", _Handler.version),
    ("GET", "/events", _Handler.events),
    ("GET", "/containers/json", _Handler.list),
    ("GET", f"/containers/{_REF}/json", _Handler.inspect),
    ("GET", f"/containers/{_REF}/top", _Handler.top),
    ("*", f"/containers/{_REF}/archive", _Handler.archive),
    ("POST", f"/containers/{_REF}/(start|stop|restart|kill|pause|unpause)", _Handler.act),
    ("POST", "/containers/create", _Handler.create),
    ("DELETE", f"/containers/{_REF}", _Handler.remove),
    ("POST", f"/containers/{_REF}/exec", _Handler.exec_create),
    ("POST", f"/exec/{_REF}/start", _Handler.exec_start),
    ("GET", f"/networks/{_REF}", _Handler.network),
    ("POST", f"/networks/{_REF}/(connect|disconnect)", _Handler.connect),
]
