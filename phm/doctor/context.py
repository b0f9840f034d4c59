"""What the groups of `phm doctor` look at: the configuration, the engine, and the places of the kernel's files."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from phm.core.settings import Settings
from phm.facts import CannotTell, ContainerFact
from phm.probes.docker import own_ids
from phm.probes.docker_facts import container_fact
from phm.setup import discovery
from phm.setup.machine import Machine
from phm.transport.docker import DockerEngine, EngineMissing


@dataclass(slots=True)
class DoctorContext:
    """Thread-safe. Tests set the places.

    settings:      those of a valid configuration, else the defaults.
    configuration: the file they come from, empty for the defaults.
    problem:       why there is no valid configuration, else empty.
    invalid:       the file that has the problem.
    """

    settings: Settings
    configuration: str = ""
    problem: str = ""
    invalid: str = ""
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    proc: Path = Path("/proc")
    sysfs: Path = Path("/sys")
    container_mark: Path = Path("/.dockerenv")
    engine: DockerEngine = field(init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _machine: Machine | CannotTell | None = None

    def __post_init__(self) -> None:
        self.engine = DockerEngine(self.settings.docker.socket)

    @property
    def dev(self) -> Path:
        """The path at which the host's /dev is mounted."""
        return Path(self.environ.get("PHM_DEV_ROOT") or self.settings.host.dev_root)

    @property
    def endpoint_ports(self) -> Sequence[str]:
        """The serial ports of MAVLink endpoints."""
        return [entry.url for entry in self.settings.mavlink.endpoints if entry.serial]

    @property
    def in_container(self) -> bool:
        return self.container_mark.exists()

    def machine(self) -> Machine:
        """What `phm init` finds, looked up once. Raises CannotTell."""
        with self._lock:
            if self._machine is None:
                try:
                    self._machine = discovery.inspect_machine(self.engine, self.dev, self.proc)
                except CannotTell as error:
                    self._machine = error
        if isinstance(self._machine, CannotTell):
            raise self._machine.with_traceback(None)
        return self._machine

    def own_container(self) -> ContainerFact | None:
        """The container that this process runs in; None when the engine does not know it. Raises CannotTell."""
        for ref in own_ids(self.proc / "self"):
            try:
                return container_fact(self.engine.inspect(ref))
            except EngineMissing:
                continue
        return None
