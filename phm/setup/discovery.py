"""Finds what `Machine` holds: one look at the Docker Engine and at /dev, each call with a deadline."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from phm.facts import CannotTell
from phm.probes.docker import own_ids
from phm.probes.docker_facts import container_fact
from phm.setup.machine import Application, Machine, SerialPort
from phm.transport.docker import DockerEngine, EngineMissing

PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
ROS_VARIABLES = (
    "ROS_DISTRO",
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    *PROFILE_VARIABLES,
)
"""What decides whether two ROS 2 processes find each other, and the distribution."""
MAX_CONTAINERS = 200
MAX_PROFILE_BYTES = 64 * 1024
_ENTRYPOINT = ["ros-entrypoint", "phm"]
"""Of PHM's image."""
_SERIAL = ("serial/by-id/*", "ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*")


def look(engine: DockerEngine, dev: Path = Path("/dev")) -> Machine:
    """Raises CannotTell, with the remedy, when the engine does not answer. dev: where the host's /dev is."""
    version = str(engine.version().get("Version") or "of unknown version")
    answers = [answer for entry in engine.list()[:MAX_CONTAINERS] if (answer := _inspect(engine, entry))]
    own = own_ids(Path("/proc/self"))  # `docker run ... init` is a container of PHM's image, too
    names = {str(answer["Id"]): str(answer.get("Name", "")).lstrip("/") for answer in answers}
    applications = [
        _application(engine, answer, names) for answer in answers if not _is_phm(answer) and _usable(answer)
    ]
    return Machine(
        engine=version,
        url=engine.url,
        socket_group_id=_group(engine.url.removeprefix("unix://")),
        applications=tuple(sorted(applications, key=lambda one: one.name)),
        sidecars=tuple(sorted(names[str(one["Id"])] for one in answers if _is_phm(one) and one["Id"] not in own)),
        serial_ports=tuple(serial_ports(dev)),
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


def _is_phm(answer: Mapping[str, Any]) -> bool:
    return (answer.get("Config") or {}).get("Entrypoint") == _ENTRYPOINT


def _application(engine: DockerEngine, answer: Mapping[str, Any], names: Mapping[str, str]) -> Application:
    config, host = answer.get("Config") or {}, answer.get("HostConfig") or {}
    labels = config.get("Labels") or {}
    fact = container_fact(answer)
    mode, _, owner = fact.network_mode.partition(":")
    environment = _environment(config.get("Env") or ())
    return Application(
        fact=fact,
        image=str(config.get("Image", "")),
        project=str(labels.get("com.docker.compose.project", "")),
        service=str(labels.get("com.docker.compose.service", "")),
        owner=_owner(owner, names) if mode == "container" else "",
        ipc_mode=str(host.get("IpcMode", "")),
        environment=environment,
        profile=_profile(engine, fact.id, environment),
    )


def _owner(ref: str, names: Mapping[str, str]) -> str:
    """Name of the container that `container:REF` means, by id or name."""
    return names.get(ref, ref if ref in names.values() else "")


def _environment(lines: object) -> dict[str, str]:
    """The ROS variables among `NAME=value` lines."""
    pairs = (str(line).partition("=") for line in lines) if isinstance(lines, (list, tuple)) else ()
    return {name: value for name, _, value in pairs if name in ROS_VARIABLES and value}


def _profile(engine: DockerEngine, container: str, environment: Mapping[str, str]) -> str:
    path = next((environment[name] for name in PROFILE_VARIABLES if name in environment), "")
    if not path.startswith("/"):
        return ""
    try:
        return engine.read_file(container, path, MAX_PROFILE_BYTES).decode("utf-8")
    except (CannotTell, UnicodeDecodeError):
        return ""


def serial_ports(dev: Path) -> Iterator[SerialPort]:
    """Serial ports below `dev`, each once: by its stable name where udev made one. Paths are those of the host."""
    seen = set()
    for pattern in _SERIAL:
        for path in sorted(dev.glob(pattern)):
            try:
                state = path.stat()
            except OSError:
                continue
            if stat.S_ISCHR(state.st_mode) and state.st_rdev not in seen:
                seen.add(state.st_rdev)
                yield SerialPort(f"/dev/{path.relative_to(dev)}", state.st_gid)


def _group(path: str) -> int | None:
    try:
        return os.stat(path).st_gid
    except OSError:
        return None
