"""Observes the demo application from outside, without PHM and without the engine: what its nodes have received lately."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docker.models.containers import Container

from sitl.application.app import plans
from sitl.application.graph import NodePlan
from sitl.application.reading import RATE_HZ, TOPIC
from sitl.application.received import FOLDER
from sitl.faults.base import Agent

PROC = Path("/proc")
FRESH_S = 2.0
"""A node that has not written its record for this long does not run: it writes twice a second."""
TOLERANCE = 0.2
PERIODS, LEAST_AGE_S = 3.0, 0.5
"""A topic is silent after this many periods, and this long."""
STAMP_S = 1.0


def works(agent: Agent, proc: Path = PROC) -> bool:
    """Whether all nodes of the application run, and each receives its topics at their rates. Needs root."""
    return container_works(agent.app, proc)


def container_works(app: Container, proc: Path = PROC) -> bool:
    """The same of its container as the engine has described it; one that was started again since then does not work."""
    expected = _plans(app)
    rates_hz = _rates_hz(expected)
    records = _records(app, proc)
    return all(
        plan.name in records
        and all(_flows(records[plan.name], topic, rates_hz[topic]) for topic in plan.subscribe if topic in rates_hz)
        for plan in expected
    )


def data_is_good(agent: Agent, proc: Path = PROC) -> bool:
    """Whether the application works and the topic `reading` has new content, right stamps and no missing numbers."""
    records = _records(agent.app, proc)
    received = [record for record in records.values() if _flows(record, TOPIC, RATE_HZ)]
    good = all(
        record[TOPIC]["same"] == 0 and record[TOPIC]["lost"] == 0 and record[TOPIC]["stamp_s"] < STAMP_S
        for record in received
    )
    return bool(received) and good and works(agent, proc)


def seen(agent: Agent, proc: Path = PROC) -> tuple[object, ...]:
    """For a test that fails: what the nodes that run have received, and the end of what the application has printed."""
    return _records(agent.app, proc), agent.app.logs(tail=30).decode(errors="replace")


def root(agent: Agent, proc: Path = PROC) -> Path | None:
    """The root folder of the running application container as this machine sees it; None: it does not run."""
    return _root(agent.app, proc)


def _root(app: Container, proc: Path) -> Path | None:
    state = app.attrs["State"]
    running = state["Running"] and not state["Paused"]
    return proc / str(state["Pid"]) / "root" if running else None


def _plans(app: Container) -> list[NodePlan]:
    command = list(app.attrs["Config"]["Cmd"] or ())
    return plans(command[command.index("sitl.application.app") + 1 :])


def _rates_hz(expected: list[NodePlan]) -> dict[str, float]:
    rates_hz: dict[str, float] = {}
    for plan in expected:
        for topic, rate_hz in plan.publish.items():
            rates_hz[topic] = rates_hz.get(topic, 0.0) + rate_hz
    return rates_hz


def _records(app: Container, proc: Path) -> dict[str, Mapping[str, Any]]:
    """What each node that runs has received, by node and topic."""
    found: dict[str, Mapping[str, Any]] = {}
    folder = _root(app, proc)
    if folder is None:
        return found
    now = time.monotonic()
    for file in (folder / FOLDER.relative_to("/")).glob("*.json"):
        try:
            record = json.loads(file.read_text("ascii"))
        except (OSError, ValueError):  # the container has ended meanwhile, or two nodes of one name write the same file
            continue
        if now - record["at"] < FRESH_S:
            found[file.stem] = record["topics"]
    return found


def _flows(record: Mapping[str, Any], topic: str, rate_hz: float) -> bool:
    seen = record.get(topic)
    if seen is None or not 0.0 <= seen["age_s"] <= max(PERIODS / rate_hz, LEAST_AGE_S):
        return False
    return bool(abs(seen["rate_hz"] - rate_hz) <= TOLERANCE * rate_hz)
