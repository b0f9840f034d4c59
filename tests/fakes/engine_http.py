"""The HTTP side of the fake Docker Engine: its routes and their responses."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import stat
import tarfile
import time
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote, urlsplit

from tests.fakes.engine_faults import (
    PATIENCE_S,
    Garbage,
    Hang,
    NoHttp,
    Oversize,
    Status,
    Trickle,
    Truncate,
)

if TYPE_CHECKING:
    from tests.fakes.engine import Server


def _nanoseconds(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 10**9 + int(fraction.ljust(9, "0")[:9])


class _Refusal(Exception):
    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Server

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
        """Whether the current fault handled the request; Trickle only changes how bytes are sent."""
        fault = self.fake.fault
        self.trickle = None
        said = f"{unquote(self.path)} {self.command}"
        if fault is None or not (fault.route in self.route or fault.route in said):
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

    # ------------------------------------------------------------ responses

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
            shown = self.query.get("all") == "1" or entry["State"]["Status"] in ("running", "paused")
            if shown and all(label in labels or label in [f"{k}={v}" for k, v in labels.items()] for label in wanted):
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
        if str(Path(path).parent) in entry["_folders"]:
            self._from_folder(entry, path)
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

    def _from_folder(self, entry: dict[str, Any], path: str) -> None:
        """A file of a folder of the test; `fake.archived` is called before it is packed."""
        file = Path(entry["_folders"][str(Path(path).parent)], Path(path).name)
        self.fake.archived(self.command, file.name)
        try:
            about = os.lstat(file)
        except FileNotFoundError:
            raise _Refusal(404, f"Could not find the file {path}") from None
        special = 1 << 27 if stat.S_ISLNK(about.st_mode) else 1 << 31 if stat.S_ISDIR(about.st_mode) else 0
        changed = f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(about.st_mtime))}.{about.st_mtime_ns % 10**9:09d}Z"
        head = {
            "X-Docker-Container-Path-Stat": _stat(file.name, about.st_size, about.st_mode & 0o777 | special, changed)
        }
        packed = io.BytesIO()
        if self.command == "GET":
            with tarfile.open(fileobj=packed, mode="w") as archive:
                archive.add(file, file.name, recursive=False)
        self._send(200, entry["_tars"].get(path) or packed.getvalue(), {**head, "Content-Type": "application/x-tar"})

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
        made = self.fake.create(name, image, self.body.get("Labels"))
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
        driver = self.fake.networks.get(name, {}).get("Driver", "bridge")
        self._json({"Name": name, "Id": network_id, "Driver": driver, "Containers": {}})

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
            fixed = given.get("IPAMConfig") or {}
            networks[name] = {
                "NetworkID": network_id,
                "IPAddress": fixed.get("IPv4Address") or "10.9.0.99",
                "Aliases": given.get("Aliases"),
                "IPAMConfig": fixed or None,
            }
        self.fake.emit("network", verb, network_id, name=name, container=entry["Id"], type="bridge")
        self._send(200, b"")


def _stat(name: str, size: int, mode: int, changed: str = "2026-01-01T00:00:00Z") -> str:
    """The header that describes a path."""
    about = {"name": name, "size": size, "mode": mode, "mtime": changed, "linkTarget": ""}
    return base64.b64encode(json.dumps(about).encode()).decode()


_REF = r"([^/]+)"
_ROUTES: list[tuple[str, str, Callable[..., None]]] = [
    ("*", "/_ping", Handler.ping),
    ("GET", "/version", Handler.version),
    ("GET", "/events", Handler.events),
    ("GET", "/containers/json", Handler.list),
    ("GET", f"/containers/{_REF}/json", Handler.inspect),
    ("GET", f"/containers/{_REF}/top", Handler.top),
    ("*", f"/containers/{_REF}/archive", Handler.archive),
    ("POST", f"/containers/{_REF}/(start|stop|restart|kill|pause|unpause)", Handler.act),
    ("POST", "/containers/create", Handler.create),
    ("DELETE", f"/containers/{_REF}", Handler.remove),
    ("POST", f"/containers/{_REF}/exec", Handler.exec_create),
    ("POST", f"/exec/{_REF}/start", Handler.exec_start),
    ("GET", f"/networks/{_REF}", Handler.network),
    ("POST", f"/networks/{_REF}/(connect|disconnect)", Handler.connect),
]
