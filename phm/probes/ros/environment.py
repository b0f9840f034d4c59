"""Reads the ROS environment of the application, and PHM's own.

Best source first: /proc/PID/environ of the application's processes, which PHM may read only in the host's PID namespace
with the rights for it; otherwise the container's configuration, which lacks what an entrypoint script sets.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from phm.core.clock import Clock
from phm.core.settings import RosSettings
from phm.facts import (
    CannotTell,
    ContainerFact,
    DockerProbe,
    EnvironmentDifference,
    ProcessFact,
    RosEnvironment,
    ros_variables,
)
from phm.probes.docker import own_ids
from phm.probes.ros.child_environment import child_environ
from phm.probes.ros.environment_differences import differences

FRESH_S = 10.0
"""How long an answer is used, and a failure: an engine that hangs must not delay the check each time."""
HOST = "host"
FULL_ID = 64
MAX_ENVIRON = 128 * 1024
MAX_PROCESSES = 20
"""Processes of a container whose environment PHM tries to read."""


class RosEnvironments:
    """Implements `phm.facts.EnvironmentProbe`. Thread-safe."""

    def __init__(
        self,
        docker: DockerProbe,
        ros: RosSettings,
        clock: Clock,
        environ: Mapping[str, str] = os.environ,
        proc: Path = Path("/proc"),
    ) -> None:
        self._docker, self._ros, self._clock, self._environ, self._proc = docker, ros, clock, environ, proc
        self._lock = threading.Lock()
        self._known: dict[str, tuple[float, tuple[EnvironmentDifference, ...] | CannotTell]] = {}
        """By container: when it was compared, and the result. One entry for each configured container."""

    def differences(self, container: str) -> tuple[EnvironmentDifference, ...]:
        with self._lock:
            at, found = self._known.get(container, (float("-inf"), ()))
        if self._clock.mono() - at >= FRESH_S:
            try:
                found = self._compare(container)
            except CannotTell as error:
                found = error
            with self._lock:
                self._known[container] = (self._clock.mono(), found)
        if isinstance(found, CannotTell):
            raise CannotTell(str(found))
        return found

    def _compare(self, container: str) -> tuple[EnvironmentDifference, ...]:
        fact = self._docker.container(container)
        if fact is None:
            raise CannotTell(f"{container} does not exist")
        application = replace(of_container(fact, self._processes(container), self._proc), name=container)
        phm = of_phm(self._ros, self._environ, self._docker.own_container())
        return differences(application, phm, configured_domain=self._ros.domain is not None)

    def _processes(self, container: str) -> Sequence[ProcessFact]:
        """Asked for only where they may be readable."""
        if not _host_processes(self._proc):
            return ()
        try:
            return self._docker.processes(container)
        except CannotTell:
            return ()


def of_container(
    fact: ContainerFact, processes: Sequence[ProcessFact] = (), proc: Path = Path("/proc")
) -> RosEnvironment:
    """The ROS environment of a container: of one of its processes if PHM may read it, else of its configuration.

    processes: those of the container, with process ids as in `proc`.
    """
    configured = RosEnvironment(
        fact.name,
        fact.ros_variables,
        exact=False,
        network_namespace=_namespace(fact.network_mode, fact.id),
        networks=frozenset(one.name for one in fact.networks) if fact.network_mode != HOST else frozenset(),
        ipc_namespace=_namespace(fact.ipc_mode, fact.id),
    )
    parents = {process.parent for process in processes}
    leaves = [process.pid for process in processes if process.pid not in parents]
    for pid in [*leaves[:MAX_PROCESSES], fact.pid]:
        # In another PID namespace the number belongs to another process, or to none.
        if pid and fact.id in _container_ids(proc / str(pid)) and (environ := read_environ(pid, proc)):
            return replace(configured, variables=ros_variables(environ), exact=True)
    return configured


def of_phm(ros: RosSettings, environ: Mapping[str, str], own_container: ContainerFact | None) -> RosEnvironment:
    """PHM's own. environ: the daemon's environment. own_container: its container; None: it runs on the host."""
    variables = ros_variables(child_environ(ros, environ))
    if own_container is None:
        return RosEnvironment("PHM", variables, network_namespace=HOST, ipc_namespace=HOST)
    return replace(of_container(replace(own_container, pid=0)), name="PHM", variables=variables, exact=True)


def of_host_processes(proc: Path = Path("/proc")) -> tuple[RosEnvironment, ...]:
    """Of each process on this machine that runs ROS and may be read, for an application without containers.

    Processes of PHM and of containers are left out; processes with equal environments are listed once.
    """
    found: dict[tuple[tuple[str, str], ...], RosEnvironment] = {}
    own = _link(proc / "self/ns/net")
    for folder in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if int(folder.name) == os.getpid() or _container_ids(folder) or not _runs_ros(folder):
            continue
        variables = ros_variables(read_environ(int(folder.name), proc))
        network = HOST if _link(folder / "ns/net") == own else _link(folder / "ns/net")
        name = _command(folder)
        found.setdefault(
            tuple(variables.items()),
            RosEnvironment(name, variables, network_namespace=network, ipc_namespace=HOST),
        )
    return tuple(found.values())


def read_environ(pid: int, proc: Path = Path("/proc")) -> dict[str, str]:
    """The environment with which a process was started; empty if PHM may not read it, or it has ended."""
    try:
        with (proc / str(pid) / "environ").open("rb") as file:
            data = file.read(MAX_ENVIRON)
    except OSError:
        return {}
    pairs = (part.partition("=") for part in data.decode("utf-8", "replace").split("\0"))
    return {name: value for name, equals, value in pairs if equals}


def _namespace(mode: str, own_id: str) -> str:
    """Identifies a namespace by the engine's mode for it: of the host, of another container, or the container's own."""
    return HOST if mode == HOST else mode.partition("container:")[2] or own_id


def _host_processes(proc: Path) -> bool:
    """Whether `proc` may show processes of other containers: its first process then is not of PHM's container."""
    first = _container_ids(proc / "1")
    return not first or first != _container_ids(proc / "self")


def _container_ids(folder: Path) -> list[str]:
    """Ids of the container in which a process runs; empty on the host."""
    return [found for found in own_ids(folder) if len(found) == FULL_ID]


def _runs_ros(folder: Path) -> bool:
    """Whether a process other than PHM's has loaded the ROS client library."""
    try:
        with (folder / "maps").open("rb") as file:
            loaded = any(b"/librcl" in line for line in file)
    except OSError:
        return False
    return loaded and "phm.probes.ros.child" not in _command(folder)


def _command(folder: Path) -> str:
    try:
        words = (folder / "cmdline").read_bytes()[:400].decode("utf-8", "replace").split("\0")
    except OSError:
        return folder.name
    line = "".join(char if char.isprintable() else "?" for char in " ".join(words).strip())
    return line[:80] or folder.name


def _link(path: Path) -> str:
    try:
        return os.readlink(path)
    except OSError:
        return ""
