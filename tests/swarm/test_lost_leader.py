"""An agent and then the leader are lost, before any other agent has reported the first: the next leader reports both."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from phm import api
from phm.core.model import Layer, Level, Slot, Transition, UnitState
from phm_checks.peers import SETTLE_S, SWARM, Peers
from sitl.simulation.fleet import STEP_S, Agent, Fleet


class Watched:
    """A fleet whose agents run the check of the other agents; failures count after SETTLE_S, as in the tracker."""

    def __init__(self, count: int) -> None:
        self.fleet = Fleet(count)
        self._checks = {
            number: Peers([other for other in self.fleet.agents if other != number]) for number in self.fleet.agents
        }
        self._bad_since: dict[tuple[int, str], float] = {}

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.fleet.run(STEP_S)
            for number in self.fleet.agents.keys() - self.fleet.down:
                self._check(self.fleet.agents[number])

    def _check(self, agent: Agent) -> None:
        world = cast(api.World, SimpleNamespace(swarm=agent.probe))
        for unit, result in self._checks[agent.number].run(world).items():
            if self._settled(agent.number, unit, result):
                self._publish(agent, unit, result)

    def _settled(self, number: int, unit: str, result: api.Result) -> bool:
        if not result.level.bad:
            self._bad_since.pop((number, unit), None)
            return True
        now = self.fleet.clock.mono()
        return unit == SWARM or now - self._bad_since.setdefault((number, unit), now) >= SETTLE_S

    def _publish(self, agent: Agent, unit: str, result: api.Result) -> None:
        old = agent.units.get(unit)
        if old is not None and (old.level, old.result.brief) == (result.level, result.brief):
            return
        state = UnitState(unit, "peers", Slot.PEERS, Layer.LINK, result.level, result, agent.clock.stamp())
        agent.units[unit] = state
        before = Level.STALE if old is None else old.level
        agent.reporters[0].handle(Transition(agent.clock.stamp(), before, state))


@pytest.mark.parametrize("end", ["dies", "loses its radio"])
@pytest.mark.parametrize("after_s", [4.0, 6.0, 10.0])
def test_the_loss_of_an_agent_is_reported_once_though_the_leader_fails_next(after_s: float, end: str) -> None:
    """Once by an agent that the ground receives, whichever of them was the leader then."""
    watched = Watched(8)
    fleet = watched.fleet
    watched.run(40)
    fleet.lines()
    fleet.down.add(3)
    watched.run(after_s)
    (fleet.down if end == "dies" else fleet.no_gcs).add(1)
    watched.run(40)
    lines = fleet.lines(3)
    assert [line[:3] for line in lines if line.endswith("FAIL 12 A03 lost")] == ["A02"]


def test_a_new_leader_does_not_repeat_an_old_loss() -> None:
    """The previous leader has reported it a minute ago."""
    watched = Watched(8)
    fleet = watched.fleet
    watched.run(40)
    fleet.down.add(3)
    watched.run(60)
    assert "A01 FAIL 12 A03 lost" in fleet.lines(3)
    fleet.down.add(1)
    watched.run(40)
    assert fleet.lines(3) == ["A02 FAIL 12 A01 lost"]
