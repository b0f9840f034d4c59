"""Finds what `Machine` holds: one look at the Docker Engine and at /dev, each call with a deadline."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from phm.core.clock import SystemClock
from phm.facts import CannotTell, ContainerFact, ProcessFact
from phm.probes.docker import own_ids
from phm.probes.docker_facts import container_fact, is_phm
from phm.probes.docker_processes import Processes
from phm.probes.ros.environment import of_container, of_host_processes
from phm.probes.ros.sandbox import PROFILE_VARIABLES
from phm.setup.machine import Application, Machine, SerialPort
from phm.transport.docker import DockerEngine, EngineMissing

MAX_CONTAINERS = 200
MAX_PROFILE_BYTES = 64 * 1024
_SERIAL = ("serial/by-id/*", "ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*")


def inspect_machine(engine: DockerEngine, dev: Path = Path("/dev"), proc: Path = Path("/proc")) -> Machine:
    """Raises CannotTell, with the remedy, when the engine does not answer. dev: where the host's /dev is."""
    version = str(engine.version().get("Version") or "of unknown version")
    answers = [answer for entry in engine.list()[:MAX_CONTAINERS] if (answer := _inspect(engine, entry))]
    own = own_ids(proc / "self")  # `docker run ... init` is a container of PHM's image, too
    names = {str(answer["Id"]): str(answer.get("Name", "")).lstrip("/") for answer in answers}
    applications = [
        _application(engine, answer, names, proc) for answer in answers if not is_phm(answer) and _usable(answer)
    ]
    return Machine(
        engine=version,
        url=engine.url,
        socket_group_id=_socket_group(engine),
        applications=tuple(sorted(applications, key=lambda one: one.name)),
        sidecars=tuple(container_fact(one) for one in answers if is_phm(one) and one["Id"] not in own),
        serial_ports=tuple(serial_ports(dev)),
        host_ros=of_host_processes(proc),
        other_devices=frozenset(_other_devices(applications, dev)),
    )


def _inspect(engine: DockerEngine, summary: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """None for a container that was removed since it was listed."""
    try:
        return engine.inspect(str(summary.get("Id", "")))
    except EngineMissing:
        return None


def _usable(answer: Mapping[str, Any]) -> bool:
    """Whether it runs, or has run and Docker keeps it running; a finished job is not an application."""
    state, host = answer.get("State") or {}, answer.get("HostConfig") or {}
    policy = (host.get("RestartPolicy") or {}).get("Name") or "no"
    return state.get("Status") in ("running", "paused", "restarting") or policy not in ("no", "on-failure")


def _application(engine: DockerEngine, answer: Mapping[str, Any], names: Mapping[str, str], proc: Path) -> Application:
    config = answer.get("Config") or {}
    labels = config.get("Labels") or {}
    fact = container_fact(answer)
    mode, _, owner = fact.network_mode.partition(":")
    ros = of_container(fact, _processes(engine, fact), proc)
    return Application(
        fact=fact,
        image=str(config.get("Image", "")),
        project=str(labels.get("com.docker.compose.project", "")),
        service=str(labels.get("com.docker.compose.service", "")),
        owner=_owner(owner, names) if mode == "container" else "",
        ros=ros,
        profile=_profile(engine, fact.id, ros.variables),
    )


def _processes(engine: DockerEngine, fact: ContainerFact) -> Sequence[ProcessFact]:
    try:
        return Processes(engine, SystemClock()).inspect(fact.id) if fact.running else ()
    except CannotTell:
        return ()


def _owner(ref: str, names: Mapping[str, str]) -> str:
    """Name of the container that `container:REF` means, by id or name."""
    return names.get(ref, ref if ref in names.values() else "")


def _profile(engine: DockerEngine, container: str, variables: Mapping[str, str]) -> str:
    path = next((variables[name] for name in PROFILE_VARIABLES if name in variables), "")
    if not path.startswith("/"):
        return ""
    try:
        return engine.read_file(container, path, MAX_PROFILE_BYTES).decode("utf-8")
    except (CannotTell, UnicodeDecodeError):
        return ""


def serial_ports(dev: Path, named: Sequence[str] = ()) -> Iterator[SerialPort]:
    """Serial ports below `dev`, each once: by its stable name where udev made one. Paths are those of the host.

    named: further paths, e.g. /dev/ttyS0; the others of that kind are not listed, as most of them lead nowhere.
    """
    seen = set()
    more = [dev / path.removeprefix("/dev/") for path in named if path.startswith("/dev/")]
    for path in (*(path for pattern in _SERIAL for path in sorted(dev.glob(pattern))), *more):
        try:
            state = path.stat()
        except OSError:
            continue
        if stat.S_ISCHR(state.st_mode) and state.st_rdev not in seen:
            seen.add(state.st_rdev)
            yield SerialPort(f"/dev/{path.relative_to(dev)}", state.st_gid)


def _other_devices(applications: Sequence[Application], dev: Path) -> Iterator[str]:
    """Mapped paths of the host that exist below `dev` and are no character devices."""
    for path in {device.host_path for one in applications for device in one.fact.devices}:
        try:
            mode = os.stat(dev / os.path.relpath(path, "/dev")).st_mode
        except OSError:
            continue  # the check says that it is missing
        if not stat.S_ISCHR(mode):
            yield path


def _socket_group(engine: DockerEngine) -> int | None:
    """The group that owns the engine's socket as containers see it. The user of a rootless engine is root in them."""
    try:
        group = os.stat(engine.url.removeprefix("unix://")).st_gid
    except OSError:
        return None
    try:
        options = engine.call(lambda client: client.info().get("SecurityOptions"), what="read its settings")
    except CannotTell:
        options = None
    return 0 if "name=rootless" in (options or ()) else group
