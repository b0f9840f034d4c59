"""The Docker Engine as a swarm uses it: Compose to make things, labels to find and remove them."""

from __future__ import annotations

import contextlib
import grp
import os
import re
import subprocess
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from docker import DockerClient
from docker.errors import APIError, NotFound

from sitl.harness.compose_stack import ROOT

LABEL = "phm.sitl.swarm"
"""Everything that belongs to a swarm has it, with the swarm's name."""
COMPOSE_LIMIT_S = 180.0
SOCKET = Path("/var/run/docker.sock")
AGENT_FILES = ("docker/compose.yaml", "docker/compose.swarm.yaml")
AS_FOUND_FILE = "docker/compose.as-found.yaml"
AIR_FILES = ("docker/compose.air.yaml",)
REMOVE_AT_ONCE = 4


def compose(
    project: str, files: Sequence[str], words: Sequence[str], variables: Mapping[str, str], keep: Sequence[int] = ()
) -> None:
    """One `docker compose` command. keep: open files that it inherits. RuntimeError has what it said when it fails."""
    named = [word for name in files for word in ("--file", str(ROOT / name))]
    done = subprocess.run(
        ["docker", "compose", "--project-name", project, *named, *words],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=COMPOSE_LIMIT_S,
        check=False,
        pass_fds=tuple(keep),
    )
    if done.returncode != 0:
        raise RuntimeError(
            f"docker compose {words[0]} of {project} ended with {done.returncode}: {done.stderr.strip()}"
        )


def groups() -> dict[str, str]:
    """The groups of this machine that PHM's container needs, for docker/compose.yaml."""
    try:
        dialout = grp.getgrnam("dialout").gr_gid
    except KeyError:
        dialout = 20
    return {"DOCKER_GID": str(SOCKET.stat().st_gid), "DIALOUT_GID": str(dialout)}


@dataclass(frozen=True)
class Resource:
    """Something of the engine that belongs to a swarm. kind: container, network or volume."""

    kind: str
    id: str
    name: str


def resources(client: DockerClient, name: str) -> list[Resource]:
    """All containers, networks and volumes of a swarm, in the order in which they can be removed."""
    label: dict[str, str | list[str] | bool] = {"label": f"{LABEL}={name}"}
    containers = client.containers.list(all=True, filters=label, ignore_removed=True)
    # PHM first: it would start again what is removed under its eyes.
    containers.sort(key=lambda one: one.labels.get("com.docker.compose.service") != "phm")
    return [
        *(Resource("container", str(one.id), str(one.name)) for one in containers),
        *(Resource("network", str(one.id), str(one.name)) for one in client.networks.list(filters=label)),
        *(Resource("volume", str(one.id), str(one.name)) for one in client.volumes.list(filters=label)),
    ]


def others(client: DockerClient, name: str) -> list[str]:
    """Names of the running containers that do not belong to the swarm. They take CPU time from what is measured: an engine starts
    those with a restart policy again, also of tests that were ended before they removed them."""
    running = client.containers.list(ignore_removed=True)
    return sorted(str(one.name) for one in running if one.labels.get(LABEL) != name)


def remove(client: DockerClient, name: str) -> int:
    """Remove what belongs to the swarm, and nothing else; how many things that were. RuntimeError names what would not go."""
    found, failed = resources(client, name), []
    for kind in ("container", "network", "volume"):
        with ThreadPoolExecutor(REMOVE_AT_ONCE) as pool:
            failed += [words for words in pool.map(_removed, (thing for thing in found if thing.kind == kind)) if words]
    if failed:
        raise RuntimeError("could not be removed: " + "; ".join(failed))
    return len(found)


def _removed(thing: Resource) -> str:
    """Why not, in words; empty when it is gone."""
    client = DockerClient.from_env()  # one for each thread: they are not safe to share
    try:
        {"container": _container, "network": _network, "volume": _volume}[thing.kind](client, thing.id)
    except NotFound:
        return ""
    except APIError as error:
        return f"{thing.name}: {error.explanation or error}"
    finally:
        client.close()
    return ""


def _container(client: DockerClient, number: str) -> None:
    container = client.containers.get(number)
    if container.status == "paused":
        container.unpause()
    container.remove(force=True, v=True)


def _network(client: DockerClient, number: str) -> None:
    network = client.networks.get(number)
    for one in network.attrs.get("Containers") or {}:
        with contextlib.suppress(APIError):
            network.disconnect(one, force=True)
    network.remove()


def _volume(client: DockerClient, number: str) -> None:
    client.volumes.get(number).remove(force=True)


def devices(name: str) -> list[Path]:
    """The devices of this machine that were made for agents of the swarm (`Agent.device`)."""
    form = re.compile(re.escape(name.replace("-", "_")) + r"_\d+_radio\Z")
    return [path for path in Path("/dev").iterdir() if form.match(path.name)]


def published(client: DockerClient, name: str, port: int) -> tuple[str, int] | None:
    """Where a port of the air's container is on this machine; None while it does not run."""
    labels = [f"{LABEL}={name}", "com.docker.compose.service=air"]
    for container in client.containers.list(filters={"label": labels}, ignore_removed=True):
        bound = container.ports.get(f"{port}/tcp") or []
        for entry in bound:
            return str(entry["HostIp"]), int(entry["HostPort"])
    return None
