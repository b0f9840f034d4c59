"""External observations during a trial: each agent's record, messages at the ground."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from sitl.campaign.application_watcher import ApplicationWatcher
from sitl.campaign.event_collector import Levels, note
from sitl.campaign.machine_load import MachineMeter
from sitl.campaign.trial import Line, Trial
from sitl.harness.log_follower import Event, Record
from sitl.simulation.ground import Ground
from sitl.swarm.swarm import SwarmAgent

PHM_COMPONENT = 193
LAST = 3
"""Heartbeats from before a trial that are kept, so that a gap over its beginning is seen."""


class GroundListener:
    """The ground's view: heartbeats and bytes of each agent's PHM, and every line, between `start` and `stop`."""

    def __init__(self, url: str) -> None:
        self._lock = threading.Lock()
        self._heartbeats: dict[int, list[float]] = {}
        self._bytes: dict[int, int] = {}
        self.ground = Ground(url, on_frame=self._frame)

    def start(self) -> None:
        self.ground.start()

    def stop(self) -> None:
        self.ground.stop()

    def begin(self) -> None:
        """Start a trial: reset the counters, keep the last heartbeats."""
        with self._lock:
            self._heartbeats = {agent: times[-LAST:] for agent, times in self._heartbeats.items()}
            self._bytes = {}
        self.ground.lines.clear()

    def fill(self, trial: Trial) -> None:
        """Fill in what was received since `begin`."""
        with self._lock:
            trial.heartbeats = {agent: [round(beat, 3) for beat in times] for agent, times in self._heartbeats.items()}
            trial.received = dict(self._bytes)
        trial.lines = [Line(line.system, line.severity, line.text, line.mono) for line in list(self.ground.lines)]

    def received(self) -> set[int]:
        """Agents whose PHM was received at all."""
        with self._lock:
            return set(self._heartbeats)

    def _frame(self, mono: float, message: Any) -> None:
        if message.get_srcComponent() != PHM_COMPONENT:
            return
        agent = message.get_srcSystem()
        with self._lock:
            self._bytes[agent] = self._bytes.get(agent, 0) + len(message.get_msgbuf())
            if message.get_type() == "HEARTBEAT":
                self._heartbeats.setdefault(agent, []).append(mono)


class SwarmWatcher:
    """All agents' records and levels, the ground listener, the machine's load and the applications, between `start` and `stop`. Call
    `update` often. busy: as `Levels`."""

    def __init__(self, agents: Mapping[int, SwarmAgent], ground: GroundListener, *, busy: bool = False) -> None:
        self.ground = ground
        self._records = {number: Record(agent.record) for number, agent in agents.items()}
        self.levels = {number: Levels(busy=busy) for number in agents}
        self.usual: dict[int, dict[str, str]] = {number: {} for number in agents}
        self.events: dict[int, list[Event]] = {number: [] for number in agents}
        """Each agent's events of the trial, the last one if none runs."""
        self._trial: Trial | None = None
        self.machine = MachineMeter()
        self.applications = ApplicationWatcher(agents)

    def start(self) -> None:
        for part in (self.ground, self.machine, self.applications):
            part.start()

    def stop(self) -> None:
        for part in (self.ground, self.machine, self.applications):
            part.stop()

    def begin(self, trial: Trial) -> None:
        """From now on everything is recorded in this trial."""
        self.update()
        self.ground.begin()
        self.machine.begin()
        self.applications.begin()
        for events in self.events.values():
            events.clear()
        self._trial = trial

    def end(self) -> None:
        """End the trial: set `ended`, and fill in the ground's part."""
        self.update()
        if self._trial is not None:
            self._trial.ended = time.monotonic()
            self._trial.machine = self.machine.samples()
            self._trial.broken = self.applications.broken()
            self.ground.fill(self._trial)
        self._trial = None

    def update(self) -> None:
        for agent, record in self._records.items():
            record.update()
            events, record.events[:] = list(record.events), []
            for event in events:
                self.levels[agent].take(event)
                if self._trial is not None and event["mono"] >= self._trial.began:
                    self.events[agent].append(event)
                    note(self._trial, agent, event)

    def learn(self) -> None:
        """Take the present levels as the usual ones: with nothing injected, some units may be unknown permanently."""
        self.usual = {agent: levels.as_usual() for agent, levels in self.levels.items()}

    def not_ok(self) -> dict[int, list[str]]:
        """Agents that are not as usual, and why."""
        found = {agent: levels.not_ok(self.usual[agent]) for agent, levels in self.levels.items()}
        return {agent: words for agent, words in found.items() if words}
