"""Many agents on one clock: each with the real probe, reporters and send queue, connected by links with configured
losses.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterable, Sequence, Set
from typing import Any

from phm.core.model import Layer, Level, Report, Result, Slot, Transition, UnitState
from phm.facts import LinkFact
from phm.probes.swarm import SwarmMonitor as Probe
from phm.reporters.base import ReporterContext
from phm.reporters.mavlink import MavlinkReporter
from phm.reporters.swarm import SwarmReporter
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock, settings
from phm.transport.mavlink_codec import Codec
from phm.transport.priority import MessagePriority
from phm.transport.send_queue import SendQueue

STEP_S = 0.25


class Port:
    """A hub with one link: messages wait in a real send queue until the fleet calls `leave`."""

    def __init__(self, agent: int, clock: FakeClock, budget: float | None) -> None:
        self.outbox = SendQueue(clock, budget)
        self.codec = Codec(agent, 193, lambda _: True)
        self.bytes_out = 0
        self.bytes_by: Counter[str] = Counter()
        """Bytes that left, by the type of message."""
        self.sent_keys: Counter[str] = Counter()
        """How often each key was sent: `refresh`, a unit, or a key of the swarm reporter."""
        self.agents = 1
        self._listeners: list[tuple[Callable[[Any, str], None], frozenset[int]]] = []

    def set_agent_count(self, agents: int, *, leads: bool = False) -> None:
        self.agents = agents
        self.outbox.set_agent_count(agents, leads=leads)

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
        only_while: tuple[str, ...] = (),
        only_replace: bool = False,
    ) -> None:
        self.sent_keys[key] += not only_replace
        self.outbox.put(message, self.codec.size(message), kind, key, urgency, only_while, only_replace=only_replace)

    def set_true(self, names: Set[str]) -> None:
        self.outbox.set_true(names)

    def links(self) -> tuple[LinkFact, ...]:
        return ()

    def listen(self, callback: Callable[[Any, str], None], ids: Iterable[int]) -> None:
        self._listeners.append((callback, frozenset(ids)))

    def watch(self, callback: Callable[[], None]) -> None:
        """Not used: the fleet polls."""

    def leave(self) -> list[bytes]:
        frames = []
        for item in iter(self.outbox.take, None):
            frames.append(self.codec.pack(item.message))
            self.bytes_by[item.message.get_type()] += len(frames[-1])
            self.bytes_out += len(frames[-1])
        return frames

    def receive(self, messages: Iterable[Any]) -> None:
        for message in messages:
            for callback, ids in self._listeners:
                if message.get_msgId() in ids:
                    callback(message, "mesh")


class Agent:
    """One agent, whose state is set from outside."""

    def __init__(
        self, number: int, clock: FakeClock, fleet: list[int], budget: float | None, units: Sequence[UnitState] = ()
    ) -> None:
        self.number, self.clock = number, clock
        self.port = Port(number, clock, budget)
        self.settings = settings(agent={"id": number}, swarm={"agents": fleet})
        self.gcs_received: float | None = None
        self.radio = False
        self.units = {state.unit: state for state in units} or {
            name: UnitState(name, name, slot, Layer.ROS, Level.OK, Result(Level.OK, ""), clock.stamp())
            for slot, name in ((Slot.CONTAINER, "container/app"), (Slot.NODES, "nodes/a"))
        }
        self.probe = Probe(
            self.port,  # type: ignore[arg-type]
            number,
            self.settings.mavlink,
            self.settings.swarm,
            clock,
            self._gcs_age,
            lambda: None,
        )
        self.context = context = ReporterContext(
            reporter_settings(self.settings),
            clock,
            "boot",
            lambda: tuple(self.units.values()),
            lambda: True,
            dict,
            self.port,
            swarm=self.probe,
            autopilot=lambda: True,
            radio=lambda: self.radio,
        )
        reporter, leader = MavlinkReporter.build(context), SwarmReporter.build(context)
        assert reporter is not None
        assert leader is not None
        self.reporters = (reporter, leader)
        reporter.handle(Report(clock.stamp(), 1, clock.stamp(), tuple(self.units.values())))

    def become(self, unit: str, level: Level, brief: str = "") -> None:
        old = self.units[unit]
        self.units[unit] = UnitState(
            unit, unit, old.slot, old.layer, level, Result(level, "", brief), self.clock.stamp()
        )

    def tick(self, units: Sequence[UnitState]) -> None:
        """Set the units; changes are published as by the tracker."""
        before, self.units = self.units, {state.unit: state for state in units}
        for state in units:
            old = before[state.unit].level if state.unit in before else Level.STALE
            if old is not state.level:
                self.reporters[0].handle(Transition(self.clock.stamp(), old, state))

    def _gcs_age(self) -> float | None:
        return None if self.gcs_received is None else self.clock.mono() - self.gcs_received


class Fleet:
    """`count` agents from number 1 on, without 51. `no_gcs`: agents without a link to the ground. `cut`: (sender,
    receiver) pairs.

    units: the results of each agent's checks; a few default ones. step_s: step of the clock; a large one is faster to
    compute.
    """

    def __init__(
        self,
        count: int,
        *,
        loss: float = 0.0,
        seed: int = 1,
        budget: float | None = 158.0,
        units: Sequence[UnitState] = (),
        step_s: float = STEP_S,
    ) -> None:
        self.clock, self._step_s = FakeClock(), step_s
        numbers = [number for number in range(1, 251) if number != 51][:count]
        self.agents = {number: Agent(number, self.clock, numbers, budget, units) for number in numbers}
        self.down: set[int] = set()
        self.no_gcs: set[int] = set()
        self.cut: set[tuple[int, int]] = set()
        self.ground: list[tuple[int, int, str]] = []
        """What the ground station received: agent, severity, text."""
        self._loss, self._random = loss, random.Random(seed)
        self._parser = Codec(255, 190, lambda _: True).parser()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self._step_s)):
            self.clock.advance(self._step_s)
            up = [agent for number, agent in self.agents.items() if number not in self.down]
            for agent in up:
                if agent.number not in self.no_gcs:
                    agent.gcs_received = self.clock.mono()
                for reporter in agent.reporters:
                    reporter.tick()
                agent.probe.wake_if_changed()
            for agent in up:
                self._deliver(agent.number, agent.port.leave(), up)

    def lines(self, least: int = 7) -> list[str]:
        """Lines of at most this severity number that the ground received since the last call."""
        found = [text for _, severity, text in self.ground if severity <= least]
        self.ground.clear()
        return found

    def _deliver(self, sender: int, frames: list[bytes], up: list[Agent]) -> None:
        messages = self._parser.feed(b"".join(frames))
        for agent in up:
            if agent.number != sender and (sender, agent.number) not in self.cut:
                agent.port.receive(message for message in messages if self._random.random() >= self._loss)
        if sender not in self.no_gcs:
            self.ground += [
                (sender, message.severity, message.text) for message in messages if message.get_type() == "STATUSTEXT"
            ]
