"""Flights of the swarm: armed periods of any agent that overlap are one flight."""

from __future__ import annotations

from dataclasses import dataclass

from phm.review.record import Record
from phm.review.spans import clipped, joined

BETWEEN_S = 1.0


@dataclass(frozen=True)
class Flight:
    """From the first arming to the last disarming. number: counts within the record. agents: those that were armed."""

    number: int
    begin: float
    end: float
    agents: tuple[str, ...]


def flights(record: Record) -> list[Flight]:
    spans = joined([span for agent in record.agents for span in agent.armed], BETWEEN_S)
    return [
        Flight(number, begin, end, tuple(agent.name for agent in record.agents if clipped(agent.armed, begin, end)))
        for number, (begin, end) in enumerate(spans, 1)
    ]
