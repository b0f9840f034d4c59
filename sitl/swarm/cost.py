"""What a swarm costs: processor time and memory of each of its containers, by the engine's own account."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from docker import DockerClient
from docker.errors import DockerException

from sitl.swarm import engine

AT_ONCE = 4


@dataclass(frozen=True)
class Cost:
    """cpu_percent: of one core, while it was measured, with the health checks in it. cpu_s: since its start. memory_mb:
    without what the kernel could drop."""

    name: str
    service: str
    cpu_percent: float
    cpu_s: float
    memory_mb: float


def measure(name: str, seconds: float) -> list[Cost]:
    """The running containers of a swarm, watched for this long. One that ended meanwhile is left out."""
    client = DockerClient.from_env()
    try:
        label = f"{engine.LABEL}={name}"
        found = client.containers.list(filters={"label": label}, ignore_removed=True)
        services = {str(one.name): str(one.labels.get("com.docker.compose.service")) for one in found}
    finally:
        client.close()
    before = _measure(services)
    time.sleep(seconds)
    after = _measure(services)
    both = sorted(before.keys() & after.keys())
    return [between(one, services[one], before[one], after[one]) for one in both]


def between(name: str, service: str, before: tuple[float, Any], after: tuple[float, Any]) -> Cost:
    """From two answers of the engine, each with the moment at which it came, in seconds."""
    used_s = [found["cpu_stats"]["cpu_usage"]["total_usage"] / 1e9 for _, found in (before, after)]
    memory = after[1]["memory_stats"]
    kept = memory.get("stats", {})
    # Control groups of version 1 and 2 have different names for pages that were read and not used again.
    idle = kept.get("total_inactive_file", kept.get("inactive_file", 0))
    percent = 100 * (used_s[1] - used_s[0]) / (after[0] - before[0])
    return Cost(name, service, percent, used_s[1], (memory["usage"] - idle) / 1e6)


def _measure(services: Mapping[str, str]) -> dict[str, tuple[float, Any]]:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        answers = zip(services, pool.map(_stats, services), strict=True)
        return {name: answer for name, answer in answers if answer is not None}


def _stats(name: str) -> tuple[float, Any] | None:
    client = DockerClient.from_env()  # one for each thread: they are not safe to share
    try:
        found = client.api.stats(name, stream=False, one_shot=True)
        moment = time.monotonic()
    except DockerException:
        return None
    finally:
        client.close()
    return (moment, found) if found.get("memory_stats", {}).get("usage") else None
