"""What the Docker Engine knows of the configured containers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from phm.core.settings.containers import ContainerSettings
from phm.facts import CannotTell
from phm.probes.docker_facts import is_configured
from phm.transport.docker import DockerEngine

LINES = 5000
LOG_BYTES = 5_000_000
DEADLINE_S = 20.0


def reference(engine: DockerEngine, container: ContainerSettings) -> str:
    """Its name, or the id of the only container with its label. Raises CannotTell."""
    if container.name:
        return container.name
    listed = engine.list(label=container.label or "", deadline_s=DEADLINE_S)
    found = [entry for entry in listed if is_configured(container, entry)]
    if len(found) != 1:
        raise CannotTell(f"{len(found)} containers have the label {container.label}")
    return str(found[0]["Id"])


def inspected(engine: DockerEngine, container: ContainerSettings) -> tuple[str, Mapping[str, Any]]:
    """Its reference, and what the engine says of it. Raises CannotTell."""
    ref = reference(engine, container)
    return ref, engine.inspect(ref, deadline_s=DEADLINE_S)


def environment(inspected: Mapping[str, Any]) -> Iterator[str]:
    """The variables of a container, as ``NAME=value``."""
    config = inspected.get("Config")
    listed = config.get("Env") if isinstance(config, dict) else None
    yield from (entry for entry in listed or () if isinstance(entry, str)) if isinstance(listed, list) else ()


def log(engine: DockerEngine, ref: str) -> str:
    """The end of a container's log. Raises CannotTell."""
    data = engine.logs(ref, "0", tail=LINES, limit=LOG_BYTES, deadline_s=DEADLINE_S)
    if len(data) > LOG_BYTES - (64 << 10):  # the last line may be cut, within a secret
        data = data.rpartition(b"\n")[0]
    return data.decode("utf-8", "replace")
