"""Fakes of the companion computer, and of PHM itself."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

from phm.facts import ConnectionFact, DeviceFact, DiskFact, HostFact, HttpFact, SelfFact, SerialFact
from phm.testing.fake import Fake


class FakeHost(Fake):
    """A calm machine, until `change` says otherwise."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        calm = HostFact(
            cpu_percent=10.0,
            memory_percent=40.0,
            memory_available_bytes=2_000_000_000,
            disks=(DiskFact("/", 50.0, 10_000_000_000, 5.0, total_bytes=20_000_000_000),),
            load_per_core=0.2,
            temperature_c=50.0,
            temperature_of="cpu_thermal",
            throttled=(),
            clock_synchronized=True,
        )
        self.fact = dataclasses.replace(calm, **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def read(self) -> HostFact:
        self._asked()
        return self.fact


class FakeDevices(Fake):
    """Devices by path on the host. `opened` lists the paths that a check asked to open."""

    def __init__(self) -> None:
        super().__init__()
        self.devices: dict[str, DeviceFact] = {}
        self.opened: list[str] = []
        self.ports: tuple[DeviceFact, ...] = ()

    def put(self, path: str, **fields: Any) -> None:
        """Let a character device be there that can be opened, unless `fields` say else."""
        plain = DeviceFact(path, character=True, major=188, minor=0, openable=True)
        self.devices[path] = dataclasses.replace(plain, **fields)

    def inspect(self, path: str, *, open_it: bool) -> DeviceFact | None:
        self._asked()
        if open_it:
            self.opened.append(path)
        return self.devices.get(path)

    def matching(self, patterns: Sequence[str], *, without: Sequence[str] = ()) -> tuple[DeviceFact, ...]:
        self._asked()
        facts = {fact.path: fact for path, fact in self.devices.items() if any(fnmatchcase(path, p) for p in patterns)}
        for path, fact in self.devices.items():
            if any(fnmatchcase(path, pattern) for pattern in without):
                facts.pop(fact.path, None)
        return tuple(facts[path] for path in sorted(facts)[: DeviceFact.MAX_MATCHES])

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        self._asked()
        return self.ports


class FakeSerial(Fake):
    """What arrived on serial ports, by path."""

    def __init__(self) -> None:
        super().__init__()
        self.ports: dict[str, SerialFact] = {}

    def inspect(self, path: str, *, baud: int, line: str) -> SerialFact:
        self._asked()
        return self.ports.get(path, SerialFact(problem="it has not been opened yet"))


class FakeSockets(Fake):
    """Servers by host and port, and answers by URL; others refuse the connection."""

    def __init__(self) -> None:
        super().__init__()
        self.servers: dict[tuple[str, int], ConnectionFact] = {}
        self.pages: dict[str, HttpFact] = {}

    def connect(self, host: str, port: int, *, timeout_s: float, expect: str = "") -> ConnectionFact:
        self._asked()
        return self.servers.get((host, port), ConnectionFact("the connection was refused", 0.0))

    def get(self, url: str, *, timeout_s: float, pattern: str = "", verify_tls: bool = True) -> HttpFact:
        self._asked()
        fact = self.pages.get(url, HttpFact("the connection was refused", 0.0))
        return dataclasses.replace(fact, found=re.search(pattern, fact.body) is not None)


class FakeSelf(Fake):
    """A PHM without problems."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(SelfFact(uptime_s=60.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def snapshot(self) -> SelfFact:
        self._asked()
        return self.fact
