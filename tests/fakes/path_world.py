"""A simulated path from an agent to the ground: which endpoints send, by which hops, and the results of PHM's link checks.

GCS, radio and autopilot send as in flight (1 Hz, in response to PHM's heartbeats, 1 Hz); a broken hop forwards
nothing. The real checks evaluate the facts, the real tracker publishes, on a clock that the test advances.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from phm import api, testing
from phm.checking import plan, registry
from phm.core.model import Event, FaultClosed, FaultOpened, Result, Transition
from phm.facts import AutopilotFact, LinkFact, RadioFact, SenderFact
from phm.tracker import Effects, Tracker

STEP_S = 0.25
CHECKS = ("companion", "link", "gcs", "radio", "autopilot", "path", "nodes", "devices")
PILOT, GCS, RADIO = (1, 1), (255, 190), (51, 68)


class PathWorld:
    """One endpoint, `ground`, which leads to everything unless `mavlink` differs. Set what is `down`, then `run`.

    down: of `gcs`, `radio`, `link`, `router`, `pilot`. A pilot that is down forwards nothing, if the endpoint leads to both.
    """

    def __init__(
        self, leads_to: str = "both", heartbeat_s: float = 2.0, url: str = "tcp:10.0.0.1:5760", **more: Any
    ) -> None:
        endpoint = {"url": url, "name": "ground", "leads_to": leads_to}
        self.settings = testing.settings(
            mavlink={"endpoints": [endpoint], "heartbeat": heartbeat_s, **more.pop("mavlink", {})}, **more
        )
        self.leads_to, self.heartbeat_s = leads_to, heartbeat_s
        self.clock, self.links, self.ros = testing.FakeClock(), testing.FakeLinks(), testing.FakeRos()
        self.devices, self.docker = testing.FakeDevices(), testing.FakeDocker()
        self.world = testing.world(
            clock=self.clock, links=self.links, ros=self.ros, devices=self.devices, docker=self.docker
        )
        installed = {name: check for name, check in registry.checks().items() if name in CHECKS}
        self.plan = plan.build_plan(self.settings, installed)
        self.tracker = Tracker(self.plan.tracked, self.plan.graph, self.clock.stamp())
        self.events: list[Event] = []
        self.down: set[str] = set()
        self.never: set[str] = set()
        """Who was never there: of `gcs`, `radio`, `pilot`."""
        self.closed_with = (111, "Connection refused")
        self.armed = False
        self.rebooted_at: float | None = None
        self._received: dict[tuple[int, int], float] = {}
        self._due: dict[api.Check, float] = {}
        self._next = {PILOT: 0.0, GCS: 0.5, RADIO: 0.25}

    # ------------------------------------------------------------ time

    def run(self, seconds: float) -> None:
        """Advance the time: working endpoints send, checks run when they are due or triggered."""
        for _ in range(round(seconds / STEP_S)):
            self.clock.advance(STEP_S)
            self._speak()
            self._update_facts()
            self._rerun({unit for check in self._due_checks() for unit in self._units(check)})
            self._rerun(self._take(self.tracker.tick(self.clock.stamp())))

    def _due_checks(self) -> list[api.Check]:
        now, due = self.clock.mono(), []
        for entry in self.plan.scheduled:
            if now >= self._due.get(entry.check, 0.0):
                self._due[entry.check] = now + entry.period_s
                due.append(entry.check)
        return due

    def _rerun(self, units: set[str]) -> None:
        """Run the checks of these units, and those that the tracker then requests, a few times over."""
        for _ in range(5):
            checks = [entry.check for entry in self.plan.scheduled if units & set(self._units(entry.check))]
            units = set()
            for check in checks:
                units |= self._observe(check)
            if not units:
                return

    @staticmethod
    def _units(check: api.Check) -> tuple[str, ...]:
        return tuple(unit.id for unit in check.units)

    def _observe(self, check: api.Check) -> set[str]:
        answer = check.run(self.world)
        results: Mapping[str, Result] = (
            dict.fromkeys(self._units(check), answer) if isinstance(answer, Result) else answer
        )
        now, rerun = self.clock.stamp(), set[str]()
        for unit, result in results.items():
            rerun |= self._take(self.tracker.observe(unit, result, now.mono, now))
        return rerun

    def _take(self, step: Effects) -> set[str]:
        self.events += step.events
        return step.rerun

    # ------------------------------------------------------------ senders

    def _speak(self) -> None:
        now = self.clock.mono() - 1000.0
        periods = {PILOT: 1.0, GCS: 1.0, RADIO: self.heartbeat_s}
        for who, period_s in periods.items():
            if now >= self._next[who]:
                self._next[who] += period_s
                if self._passes(who):
                    self._received[who] = self.clock.mono()

    def _passes(self, who: tuple[int, int]) -> bool:
        name = {PILOT: "pilot", GCS: "gcs", RADIO: "radio"}[who]
        carriers = {"link", "router", name}
        if who == GCS:
            carriers |= {"radio"} | ({"pilot"} if self.leads_to == "both" else set())
        return not carriers & self.down and name not in self.never

    def _update_facts(self) -> None:
        now = self.clock.mono()
        ages = {who: now - at for who, at in self._received.items()}
        self.links.gcs_age, self.links.gcs_link = ages.get(GCS), "ground"
        if PILOT in ages:
            ago = None if self.rebooted_at is None else now - self.rebooted_at
            self.links.pilot = AutopilotFact(
                ages[PILOT], self.armed, 5, 4, "ground", 60.0, int(ago is not None), ago, self.armed
            )
        if RADIO in ages:
            self.links.radio_facts = (
                RadioFact("ground", ages[RADIO], self.heartbeat_s, 180, 175, 40, 45, 98, 140.0, 130.0, 0.0, 0.0),
            )
        senders = tuple(SenderFact(*who, age_s, 60, 0.0) for who, age_s in ages.items())
        base = LinkFact("ground", "link" not in self.down)
        if not base.open:
            base = dataclasses.replace(base, code=self.closed_with[0], error=self.closed_with[1])
        self.links.endpoints = (
            dataclasses.replace(
                base, rx_age_s=min(ages.values(), default=None), rx_s=120.0, tx_s=15.0, frames_s=3.0, senders=senders
            ),
        )

    # ------------------------------------------------------------ published states

    @property
    def alarms(self) -> list[str]:
        """Opened faults in their order: unit and brief."""
        faults = [event.fault for event in self.events if isinstance(event, FaultOpened)]
        return [f"{fault.unit}: {fault.result.brief}" for fault in faults]

    @property
    def closed(self) -> list[tuple[str, str]]:
        faults = [event.fault for event in self.events if isinstance(event, FaultClosed)]
        return [(fault.unit, fault.outcome.value) for fault in faults]

    @property
    def warnings(self) -> list[str]:
        """Units and briefs published as WARN, in order."""
        states = [event.state for event in self.events if isinstance(event, Transition)]
        return [f"{state.unit}: {state.result.brief}" for state in states if state.level is api.Level.WARN]

    def blocked(self) -> dict[str, str]:
        """Unit -> the unit that blocks it now."""
        return {state.unit: state.blocked_by for state in self.tracker.states() if state.blocked_by}

    def bad(self) -> set[str]:
        """Units that are published as WARN or ERROR now."""
        return {state.unit for state in self.tracker.states() if state.level.bad}

    def text(self, unit: str) -> str:
        return self.tracker.state(unit).result.summary
