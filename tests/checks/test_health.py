"""Health: a container that was unhealthy before PHM's first observation."""

from __future__ import annotations

from phm import testing
from phm.api import Level, Result
from phm.checking.check_turns import CheckRun, CheckTurns, ScheduledCheck
from phm.facts import HealthcheckFact
from phm_checks.health import Health


def test_a_container_that_is_already_unhealthy_is_an_error_from_the_first_run() -> None:
    """When PHM starts or reloads: its failed probe may be of any age, which only starvation asks for."""
    (check,) = Health.build(testing.settings(containers=[{"name": "ros_app"}]))
    clock, runs = testing.FakeClock(), list[CheckRun]()
    unhealthy = testing.container("ros_app", health="unhealthy", health_streak=3, healthcheck=HealthcheckFact())
    world = testing.world(clock=clock, docker=testing.FakeDocker(unhealthy))
    turns = CheckTurns(ScheduledCheck(check, 5.0, 10.0), world, clock, runs.append, 0.0)
    turns.start()
    turns.run(clock.mono())
    result = runs[-1].units["health/ros_app"]
    assert (result.level, result.condition, result.age_s) == (Level.ERROR, "unhealthy", float("inf")), result.summary
    assert "health check of ros_app failed 3 times in a row, expected healthy" in result.summary


def test_a_health_check_that_failed_one_time_failed_once() -> None:
    (check,) = Health.build(testing.settings(containers=[{"name": "ros_app"}]))
    unhealthy = testing.container("ros_app", health="unhealthy", health_streak=1)
    result = check.run(testing.world(docker=testing.FakeDocker(unhealthy)))
    assert isinstance(result, Result)
    assert "health check of ros_app failed once, expected healthy" in result.summary
