"""A running PHM with two containers and holds, on a fake clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phm.core.model import HoldChanged, Level
from phm.facts import COMPLETE
from phm.recovery.holds.hold_registry import HoldRegistry
from phm.recovery.holds.hold_service import HoldInputs, HoldService
from phm.recovery.safety.armed_state import ArmedState as ArmedState, ArmedStatus
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "nodes/app": Of("app", ("container/app",)), "container/cam": Of("cam")}
LADDERS = {"broken": ["restart"], "exited": ["restart"], "oom": ["restart"]}
LONG_BACKOFF = {"backoff": 50.0, "backoff_max": 60.0}
BY = "operator (uid 0)"
STOP = (("kill", "signal 15"), ("die", "exit code 0"), ("stop", ""))


class Scene:
    """PHM with two containers, of which `app` is flight-critical. `armed` is the known state of the vehicle."""

    def __init__(
        self,
        folder: Path | None = None,
        clock: FakeClock | None = None,
        containers: Containers | None = None,
        bad: dict[str, str] | None = None,
        **recovery: Any,
    ) -> None:
        self.clock, self.containers = clock or FakeClock(), containers or Containers("app", "cam")
        self.armed = ArmedState.DISARMED
        self.agent = Agent(
            UNITS,
            self.containers,
            self.clock,
            folder=folder,
            opted_in=("app", "cam"),
            critical=("app",),
            **{"ladders": LADDERS, **recovery},
        )
        self.holds: HoldRegistry = self.agent.executor.holds
        action_on = self.agent.executor.action_on
        self.stream = COMPLETE
        self.others: dict[str, dict[str, Any]] = {}
        """The engine's data of containers that are not configured, by their names."""
        world = HoldInputs(
            lambda: ArmedStatus(self.armed, "as the test says"),
            self.containers.facts.get,
            action_on,
            lambda: self.stream,
            lambda ref: self.others[ref],
        )
        self.service = HoldService(
            self.agent.settings.recovery,
            self.agent.settings.containers,
            self.holds,
            self.agent.pipeline,
            self.agent.bus.publish,
            self.clock,
            world,
        )
        self.service._apply(("app", "cam"))
        observe = self.agent.observe
        self.agent.observe = lambda: (self.service.tick(), observe())[1]  # type: ignore[method-assign]
        self.agent.bad = bad or {}
        self.agent.rest(0.5)

    def hold(self, container: str = "app", for_s: float | None = 60.0, reason: str = "new firmware") -> str:
        return self.service.hold(container, for_s, reason, BY)[0]

    def happen(self, *events: tuple[str, str], key: str = "app") -> None:
        for action, detail in events:
            self.service.happened(key, action, detail)

    def level(self, unit: str = "container/app") -> Level:
        return next(state.level for state in self.agent.pipeline.states() if state.unit == unit)

    def summary(self, unit: str = "container/app") -> str:
        return next(state.result.summary for state in self.agent.pipeline.states() if state.unit == unit)

    def changes(self) -> list[tuple[str, bool]]:
        return [(event.target, event.began) for event in self.agent.of(HoldChanged)]

    def last(self) -> str:
        found: HoldChanged = self.agent.of(HoldChanged)[-1]
        return found.text

    def stop(self) -> None:
        self.agent.stop()
        self.clock.advance(1000)


def stopped(scene: Scene, key: str = "app") -> None:
    """`docker stop`, and the checks' results after it."""
    scene.happen(*STOP, key=key)
    scene.containers.end(key)
    scene.agent.bad = {f"container/{key}": "exited"}
