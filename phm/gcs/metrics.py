"""The page of metrics of the ground: the newest state of each agent, and what was counted from events since the start.

`docs/reference/metrics.md` states the names as a contract.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from phm import __version__
from phm.core.clock import Clock
from phm.core.model import Level, Slot
from phm.gcs import metrics_catalog as metrics
from phm.gcs.events import SEVERITIES, GcsEvent, severity_name
from phm.gcs.fleet import MAX_AGENTS
from phm.gcs.presence import PresenceState
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.swarm.peers import LOST_PERIODS
from phm.transport.priority import default_periods
from phm.wire.command import CommandResult
from phm.wire.metrics_page import Labels, MetricsPage, ratio

MAX_SERIES = MAX_AGENTS * len(Slot)
MAX_GAPS = MAX_SERIES - 2 * MAX_AGENTS
"""Agents whose losses are counted; the others are for the agents of the snapshot."""
_THERE = (PresenceState.ALIVE.value, PresenceState.LATE.value)
_RADIO_SIDES = (("rssi", "noise", "local"), ("remrssi", "remnoise", "remote"))


class MeasuredStation(Protocol):
    """The part of `phm.gcs.station.GroundStation` that is read here."""

    commands_sent: int

    def subscribe(self, queue: SubscriberQueue) -> None: ...
    def snapshot(self) -> tuple[int, GcsEvent]: ...


class _Counts(SubscriberQueue):
    """Counts events by their kind as they come, and keeps none."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock, 1)
        self.texts: Counter[Labels] = Counter()
        self.events: Counter[Labels] = Counter()
        self.gaps: Counter[Labels] = Counter()
        self.answers: Counter[Labels] = Counter()
        self.guard = threading.Lock()

    def put(self, item: QueuedEvent) -> bool:
        event, body = item.event.event, item.event.body
        with self.guard:
            self.events[(event,)] += 1
            if event == "text" and not body["repeat"]:
                self.texts[(severity_name(body["severity"]).lower(),)] += 1
            elif event == "presence" and body["presence"] == PresenceState.LOST.value:
                key = (str(body["name"]), PresenceState.LOST.value)
                count = self.gaps.pop(key, 0) + 1
                # A sender can invent any number of agents: those that were lost last count.
                if len(self.gaps) >= MAX_GAPS:
                    del self.gaps[next(iter(self.gaps))]
                self.gaps[key] = count
            elif event == "ack":
                self.answers[(str(body["result"]).lower(),)] += 1
        return True


class GroundMetrics:
    """Metrics of the ground station; its counters begin at its construction."""

    def __init__(self, station: MeasuredStation, clock: Clock) -> None:
        self._station, self._counts = station, _Counts(clock)
        self._awaited_from: dict[str, float] = {}
        station.subscribe(self._counts)
        self._await(station.snapshot()[1])

    def page(self) -> MetricsPage:
        """The metrics at this moment. May be called by any thread."""
        page = MetricsPage(metrics.ALL, MAX_SERIES)
        event = self._station.snapshot()[1]
        body = event.body
        page.add(metrics.INFO, 1, __version__)
        page.add(metrics.COMMANDS, self._station.commands_sent)
        page.add(metrics.REFUSED, int(body["refused"]) + int(body["frames_refused"]))
        page.add(metrics.PROBLEMS, len(body["problems"]))
        with self._counts.guard:
            page.add_counts(metrics.EVENTS, self._counts.events)
            page.add_counts(metrics.TEXTS, self._counts.texts)
            page.add_counts(metrics.GAPS, self._counts.gaps)
            page.add_counts(metrics.ANSWERS, self._counts.answers)
        _not_yet(page, body["agents"])
        for link in body["links"]:
            page.add(metrics.LINK_OPEN, link["open"], link["link"])
        for radio in body["radios"]:
            _radio(page, radio)
        awaited_s = self._await(event)
        for agent in body["agents"]:
            _agent(page, agent, awaited_s.get(agent["name"]))
        return page

    def _await(self, event: GcsEvent) -> dict[str, float]:
        """For how long the ground has waited for agents that it never received, by name: expected ones since its start. Without those
        that may not have sent a heartbeat yet: in a large swarm they are rare."""
        now, agents = event.at.mono, event.body["agents"]
        never = [agent["name"] for agent in agents if agent["presence"] == PresenceState.NEVER.value]
        with self._counts.guard:
            self._awaited_from = {name: self._awaited_from.get(name, now) for name in never}
            awaited_s = {name: max(0.0, now - since) for name, since in self._awaited_from.items()}
        early_s = LOST_PERIODS * default_periods(len(agents))[0]
        return {name: waited_s for name, waited_s in awaited_s.items() if waited_s > early_s}


def _not_yet(page: MetricsPage, agents: Iterable[Mapping[str, Any]]) -> None:
    """0 for what has not happened yet: the first one would otherwise be no increase."""
    for severity in SEVERITIES:
        page.add(metrics.TEXTS, 0, severity.lower())
    for result in CommandResult:
        page.add(metrics.ANSWERS, 0, result.name.lower())
    for agent in agents:
        page.add(metrics.GAPS, 0, agent["name"], PresenceState.LOST.value)


def _agent(page: MetricsPage, agent: Mapping[str, Any], awaited_s: float | None) -> None:
    name = agent["name"]
    there = agent["presence"] in _THERE
    page.add(metrics.PRESENT, there, name)
    if agent["presence"] != PresenceState.LEFT.value:  # it was stopped on purpose: `PhmAgentLost` needs the age
        page.add(metrics.AGE, agent["age_s"] if awaited_s is None else round(awaited_s, 1), name)
    page.add(metrics.PERIOD, agent["period_s"], name)
    page.add(metrics.RESTARTS, agent["restarts"], name)
    page.add(metrics.GAPS, agent["late"], name, PresenceState.LATE.value)  # not an event
    if there and agent["how"] in Level.__members__:
        page.add(metrics.AGENT_LEVEL, Level[agent["how"]], name)
    for slot, level in agent["slots"].items():
        page.add(metrics.SLOT_LEVEL, Level[level], name, Slot(int(slot)).name.lower())
    autopilot = agent["autopilot"]
    if autopilot is not None:
        page.add(metrics.AUTOPILOT_AGE, autopilot["age_s"], name)
        if autopilot["presence"] in _THERE:
            page.add(metrics.ARMED, autopilot["armed"], name)


def _radio(page: MetricsPage, radio: Mapping[str, Any]) -> None:
    link = radio["link"]
    page.add(metrics.RADIO_AGE, radio["age_s"], link)
    page.add(metrics.RADIO_BUFFER, ratio(radio["txbuf"]), link)
    for signal, noise, side in _RADIO_SIDES:
        page.add(metrics.RADIO_SIGNAL, radio[signal], link, side)
        page.add(metrics.RADIO_NOISE, radio[noise], link, side)
