"""What a record and an engine say about a fault: the questions that `sitl.acceptance.main` asks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from phm.wire.report import OK_LEVELS
from sitl.faults.base import Agent
from sitl.harness.log_follower import Event


def container_state(agent: Agent) -> Mapping[str, Any]:
    """What PHM could have changed about the application container."""
    attrs = agent.app.attrs
    networks = attrs["NetworkSettings"]["Networks"]
    return {
        "id": attrs["Id"][:12],
        "started": attrs["State"]["StartedAt"],
        "status": attrs["State"]["Status"],
        "networks": {name: network["NetworkID"][:12] for name, network in networks.items()},
    }


def relapses(units: Sequence[str], events: Sequence[Event]) -> list[str]:
    """What was not OK after its recovery had been verified, in words: then the verification proved nothing."""
    found = []
    for unit in units:
        recovered = next((number for number, event in enumerate(events) if phase("verified", unit, event)), len(events))
        for event in events[recovered:]:
            if event["event"] == "transition" and event["unit"] == unit and event["level"] not in OK_LEVELS:
                after_s = event["mono"] - events[recovered]["mono"]
                found.append(f"{unit} was {event['level']} {after_s:.1f} s after it was verified: {event['summary']}")
    return found


def closed(unit: str, event: Event) -> bool:
    return bool(event["event"] == "fault_closed" and event["unit"] == unit)


def phase(wanted: str, unit: str, event: Event) -> bool:
    return bool(event["event"] == "action" and event["phase"] == wanted and event["unit"] == unit)
