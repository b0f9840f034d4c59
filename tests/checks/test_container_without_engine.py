"""Slot 2 while the Docker Engine does not respond: what the container's cgroup shows."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.recovery.base import ladder_of
from phm_checks.container import UNNOTICED_S, UNREPORTED_S, WITHOUT_ENGINE_S, Container

SETTINGS = testing.settings(containers=[{"name": "ros_app"}])
EMPTY, FROZEN, RUNNING = api.CgroupState.EMPTY, api.CgroupState.FROZEN, api.CgroupState.RUNNING
REMOVED = api.CgroupState.REMOVED
AWAY = api.NoResponse("no answer within 5 s")


class Failing(testing.FakeDocker):
    """An engine that answers each question with `fails`, if that is set."""

    fails: api.CannotTell | None = None

    def container(self, name: str, young_s: float = 0.0) -> api.ContainerFact | None:
        if self.fails is not None:
            raise self.fails
        return super().container(name, young_s)


class Away:
    """A container that the engine has described as `fields`, before it failed with `fails`."""

    def __init__(self, fails: api.CannotTell = AWAY, **fields: Any) -> None:
        (self.check,) = Container.build(SETTINGS)
        self.docker, self.pressure = Failing(testing.container("ros_app", **fields)), testing.FakePressure()
        self.world = testing.world(docker=self.docker, pressure=self.pressure)
        self.before = self.run()
        self.docker.fails = fails

    def run(self, state: api.CgroupState | None = None) -> api.Result:
        self.pressure.states = {"ros_app": state} if state is not None else {}
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result


@pytest.mark.parametrize(
    ("state", "condition", "settle_s"),
    [(EMPTY, "ended", UNNOTICED_S), (REMOVED, "ended", WITHOUT_ENGINE_S), (FROZEN, "frozen", WITHOUT_ENGINE_S)],
)
def test_its_end_is_an_error_without_an_action(state: api.CgroupState, condition: str, settle_s: float) -> None:
    """The cgroup shows it; nothing can be done about it before the engine responds. An engine that works removes an empty cgroup:
    while it is there, no one can be recreating the container."""
    away = Away()
    found = away.run(state)
    assert (found.level, found.condition, found.target) == (api.Level.ERROR, condition, "ros_app")
    assert found.settle_s == settle_s
    assert found.evidence.conclusive and found.evidence.certain
    assert away.before.evidence.generation and not found.evidence.generation, "another run may have begun"
    assert "no answer within 5 s" in found.summary
    assert ladder_of(found.condition, SETTINGS.recovery) == ()


@pytest.mark.parametrize("state", [RUNNING, None])
def test_a_container_whose_cgroup_does_not_show_its_end_is_unknown(state: api.CgroupState | None) -> None:
    """It has processes, but nothing else of it is known; or its cgroup has not been found."""
    with pytest.raises(api.NoResponse):
        Away().run(state)


@pytest.mark.parametrize("fails", [api.NotPermitted("403"), api.CannotTell("two containers have this label")])
def test_an_engine_that_answers_with_an_error_is_not_away(fails: api.CannotTell) -> None:
    """The container's cgroup may be that of an earlier container: the answer says more than it does."""
    with pytest.raises(type(fails)):
        Away(fails).run(EMPTY)


@pytest.mark.parametrize("status", ["exited", "paused"])
def test_what_was_wrong_before_still_is(status: str) -> None:
    """With the same words, and not as a consequence of the engine."""
    away = Away(status=status)
    found = away.run(FROZEN if status == "paused" else EMPTY)
    assert (found.condition, found.summary) == (away.before.condition, away.before.summary) == (status, found.summary)
    assert found.evidence.conclusive and not away.before.evidence.conclusive
    with pytest.raises(api.NoResponse):
        away.run(RUNNING)


def test_a_paused_container_can_end() -> None:
    """It is not paused any more then."""
    assert Away(status="paused").run(EMPTY).condition == "ended"


def test_a_container_that_restarted_repeatedly_and_has_ended_is_not_said_to_run() -> None:
    """Its last result was an error, too, but while it ran."""
    away = Away()
    away.docker.fails = None
    for count in range(1, 9):
        away.docker.put(testing.container("ros_app", restart_count=count, started_at=f"start {count}"))
        before = away.run()
    assert (before.level, before.condition) == (api.Level.ERROR, "restarting")
    away.docker.fails = AWAY
    assert away.run(EMPTY).condition == "ended"


def test_a_container_that_the_engine_has_never_described_is_unknown() -> None:
    """Its cgroup is not known, either."""
    (check,) = Container.build(SETTINGS)
    docker = Failing()
    docker.fails = AWAY
    with pytest.raises(api.NoResponse):
        check.run(testing.world(docker=docker, pressure=testing.FakePressure()))


@pytest.mark.parametrize("state", [EMPTY, REMOVED])
def test_an_end_that_the_engine_does_not_report_yet_is_unknown(state: api.CgroupState) -> None:
    """The engine is late on a busy machine. As OK, the end of a router was first reported as a closed endpoint."""
    away = Away()
    away.docker.fails = None
    found = away.run(state)
    assert (found.level, found.condition) == (api.Level.STALE, "")
    assert "still reports it as running" in found.summary
    assert away.run(RUNNING).level is api.Level.OK


def test_an_engine_that_reports_it_as_running_for_long_is_right() -> None:
    """Processes may have moved to another cgroup. Each new end is waited for again."""
    clock = testing.FakeClock()
    away = Away()
    away.docker.fails, away.world = None, testing.world(docker=away.docker, pressure=away.pressure, clock=clock)
    assert away.run(EMPTY).level is api.Level.STALE
    clock.advance(UNREPORTED_S)
    assert away.run(EMPTY).level is api.Level.OK
    assert away.run(RUNNING).level is api.Level.OK
    assert away.run(EMPTY).level is api.Level.STALE


def test_an_end_that_the_engine_reports_is_reported() -> None:
    """Its cgroup is removed then, too."""
    away = Away(status="exited", exit_code=1)
    away.docker.fails = None
    assert away.run(REMOVED).condition == "exited"
