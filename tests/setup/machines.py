"""Machines for tests of `phm init`: applications as the engine describes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from phm.probes.docker_facts import container_fact
from phm.probes.ros.environment import of_container
from phm.setup.machine import Application, Machine, SerialPort
from tests.fakes.engine import container

SOCKET = "unix:///var/run/docker.sock"


def described(
    name: str,
    *,
    mode: str = "swarm",
    env: Mapping[str, str] | None = None,
    devices: Sequence[str] = (),
    entrypoint: Sequence[str] = (),
    **more: Any,
) -> dict[str, Any]:
    """A container as `tests.fakes.engine.container`, with network mode, environment, devices and image."""
    networks = () if mode in ("host", "none") or mode.startswith("container:") else (mode,)
    answer = container(name, networks=networks, **more)
    answer["HostConfig"]["NetworkMode"] = mode
    answer["HostConfig"]["Devices"] = [
        {"PathOnHost": path, "PathInContainer": path, "CgroupPermissions": "rwm"} for path in devices
    ]
    answer["Config"]["Image"] = f"{name}:1"
    answer["Config"]["Env"] = [f"{key}={value}" for key, value in {"SECRET": "1", **(env or {})}.items()]
    answer["Config"]["Entrypoint"] = list(entrypoint)
    return answer


def application(name: str, *, service: str = "", owner: str = "", profile: str = "", **more: Any) -> Application:
    fact = container_fact(described(name, **more))
    return Application(
        fact=fact,
        image=f"{name}:1",
        service=service,
        owner=owner,
        ros=of_container(fact),
        profile=profile,
    )


def machine(
    *applications: Application, url: str = SOCKET, ports: Sequence[SerialPort] = (), other_devices: Sequence[str] = ()
) -> Machine:
    return Machine("27.0", url, 998, tuple(applications), (), tuple(ports), other_devices=frozenset(other_devices))
