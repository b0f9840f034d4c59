"""A real HAProxy in front of the real engine, with the rules of a configuration."""

from __future__ import annotations

import shutil
import socket
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from phm.core.settings import Settings
from phm.proxy.haproxy import rules
from phm.testing import settings
from phm.transport.docker import DockerEngine
from tests.fakes.until import until

ENGINE = "/var/run/docker.sock"
LIMIT_S = 60.0
Answer = tuple[int, bytes]


class Proxy:
    """One process of HAProxy; its socket is at `docker.socket` of the settings."""

    def __init__(self, made: Settings) -> None:
        program = shutil.which("haproxy", path="/usr/sbin:/usr/bin:/usr/local/sbin")
        if program is None:
            pytest.fail("there is no haproxy: run scripts/test, which installs it, or install the package haproxy")
        self.path = made.docker.socket.removeprefix("unix://")
        file = Path(self.path).with_name("haproxy.cfg")
        file.write_text(rules(made, ENGINE), "utf-8")
        self.said = Path(self.path).with_name("haproxy.log")
        with self.said.open("wb") as log:
            self.process = subprocess.Popen([program, "-db", "-f", str(file)], stdout=log, stderr=log)
        until(lambda: self.process.poll() is not None or self._listens(), "haproxy", self._text, limit_s=LIMIT_S)
        if self.process.poll() is not None:
            pytest.fail(f"haproxy does not start: {self._text()}")

    def _text(self) -> str:
        return self.said.read_text("utf-8", "replace")

    def _listens(self) -> bool:
        with socket.socket(socket.AF_UNIX) as stream:
            return stream.connect_ex(self.path) == 0

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait(LIMIT_S)

    def ask(
        self,
        method: str,
        path: str,
        body: bytes = b"",
        *,
        more: Mapping[str, str] | None = None,
        length: int | None = None,
    ) -> Answer:
        """Status and body of one request, sent literally."""
        headers = {"Host": "engine", "Connection": "close", "Content-Type": "application/json", **(more or {})}
        if (body or method in ("POST", "PUT")) and "Transfer-Encoding" not in headers:
            headers["Content-Length"] = str(len(body) if length is None else length)
        head = f"{method} {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        with socket.socket(socket.AF_UNIX) as stream:
            stream.settimeout(LIMIT_S)
            stream.connect(self.path)
            stream.sendall(head.encode() + b"\r\n" + body)
            answer = b""
            while piece := stream.recv(1 << 16):
                answer += piece
        return int(answer.split(b" ", 2)[1]), answer.partition(b"\r\n\r\n")[2]


class Proxies:
    """Creates proxies, and ends them."""

    def __init__(self, folder: Path, myself: str) -> None:
        self._folder, self._myself, self._made = folder, myself, 0
        self._ends: list[Callable[[], None]] = []

    def docker(self) -> dict[str, str]:
        """The section `docker` of a configuration whose engine is behind a proxy."""
        self._made += 1
        place = self._folder / str(self._made)
        place.mkdir()
        return {"socket": f"unix://{place}/engine.sock", "container": self._myself}

    def before(self, made: Settings) -> Proxy:
        proxy = Proxy(made)
        self._ends.append(proxy.stop)
        return proxy

    def client(self, made: Settings) -> DockerEngine:
        """PHM's client behind a proxy with the rules of these settings."""
        self.before(made)
        engine = DockerEngine(made.docker.socket, timeout_s=LIMIT_S)
        self._ends.append(engine.close)
        return engine

    def behind(
        self, *, docker: Mapping[str, object] | None = None, **yaml_like: object
    ) -> tuple[DockerEngine, Settings]:
        """Settings as in `phm.yaml`, and PHM's client behind their proxy."""
        made = settings(**{**yaml_like, "docker": {**(docker or {}), **self.docker()}})
        return self.client(made), made

    def end(self) -> None:
        for end in self._ends[::-1]:
            end()


@dataclass(frozen=True)
class EngineAccess:
    """A daemon's connection to the engine. section: its `docker` configuration. open: called with it before the start."""

    section: dict[str, str]
    open: Callable[[Settings], object]


class BehindProxy(DockerEngine):
    """The real engine for the test itself; PHM's client (`tests.recovery.action_bench`) is behind a proxy."""

    def __init__(self, proxies: Proxies) -> None:
        super().__init__(f"unix://{ENGINE}", timeout_s=LIMIT_S)
        self.proxies = proxies


def short_folder() -> Path:
    """The path of a unix socket has at most 107 bytes."""
    return Path(tempfile.mkdtemp(prefix="phm-proxy-"))
