"""Slot 2 while the Docker Engine does not respond: what the container's cgroup shows."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.recovery.base import ladder_of
from phm_checks.container import ENGINE_STOPS_S, Container

SETTINGS = testing.settings(containers=[{"name": "ros_app"}])


class SlowDocker(testing.FakeDocker):
    """Each request takes `takes_s`."""

    def __init__(self, clock: testing.FakeClock, *containers: api.ContainerFact) -> None:
        super().__init__(*containers)
        self.clock, self.takes_s = clock, 0.0

    def container(self, name: str, young_s: float = 0.0) -> api.ContainerFact | None:
        self.clock.advance(self.takes_s)
        return super().container(name, young_s)


class Away:
    """A container that the engine has described as `fields`, before it stopped answering."""

    def __init__(self, clock: testing.FakeClock | None = None, **fields: Any) -> None:
        (self.check,) = Container.build(SETTINGS)
        self.docker = SlowDocker(clock or testing.FakeClock(), testing.container("ros_app", **fields))
        self.world = testing.world(clock=self.docker.clock, docker=self.docker, pressure=testing.FakePressure())
        self.before = self.run()
        self.docker.fail("no answer within 5 s")

    def run(self, state: api.CgroupState | None = None) -> api.Result:
        pressure = self.world.pressure
        assert isinstance(pressure, testing.FakePressure)
        pressure.states = {"ros_app": state} if state is not None else {}
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result


def test_a_container_with_processes_runs_also_while_the_engine_does_not_respond() -> None:
    """Otherwise all that depends on it would be unknown for as long."""
    away = Away()
    found = away.run(api.CgroupState.RUNNING)
    assert (found.level, found.evidence.generation) == (api.Level.OK, away.before.evidence.generation)
    assert "no answer within 5 s" in found.summary


@pytest.mark.parametrize(
    ("state", "condition", "settle_s"),
    [(api.CgroupState.EMPTY, "ended", ENGINE_STOPS_S), (api.CgroupState.FROZEN, "frozen", None)],
)
def test_its_end_is_an_error_without_a_ladder_while_the_engine_does_not_respond(
    state: api.CgroupState, condition: str, settle_s: float | None
) -> None:
    """The cgroup shows it; nothing can be done about it before the engine responds."""
    found = Away().run(state)
    assert (found.level, found.condition, found.target, found.settle_s) == (
        api.Level.ERROR,
        condition,
        "ros_app",
        settle_s,
    )
    assert found.evidence.conclusive and found.evidence.certain
    assert ladder_of(found.condition, SETTINGS.recovery) == ()


@pytest.mark.parametrize(("takes_s", "settle_s"), [(5.0, 0.0), (0.1, ENGINE_STOPS_S)])
def test_an_end_that_was_seen_before_a_long_request_has_lasted(takes_s: float, settle_s: float) -> None:
    """Otherwise an engine that hangs would delay it by one more deadline."""
    clock = testing.FakeClock()
    away = Away(clock)
    away.docker.takes_s = takes_s
    assert away.run(api.CgroupState.EMPTY).settle_s == settle_s


@pytest.mark.parametrize("status", ["exited", "paused"])
def test_what_was_wrong_before_still_is(status: str) -> None:
    """The same words as before: nothing has changed."""
    away = Away(status=status)
    assert away.before.level is api.Level.ERROR
    same = api.CgroupState.FROZEN if status == "paused" else api.CgroupState.EMPTY
    assert away.run(same) is away.before
    with pytest.raises(api.CannotTell):
        away.run(api.CgroupState.RUNNING)


def test_a_paused_container_can_end_while_the_engine_does_not_respond() -> None:
    """It is not paused any more then."""
    assert Away(status="paused").run(api.CgroupState.EMPTY).condition == "ended"


def test_without_its_cgroup_a_container_is_unknown_while_the_engine_does_not_respond() -> None:
    """As one that the engine has never described."""
    with pytest.raises(api.CannotTell):
        Away().run()
    (check,) = Container.build(SETTINGS)
    docker = testing.FakeDocker()
    docker.fail()
    with pytest.raises(api.CannotTell):
        check.run(testing.world(docker=docker))
