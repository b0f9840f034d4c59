"""Health: a container that was unhealthy before PHM's first observation."""

from __future__ import annotations

from phm import testing
from phm.api import Level
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
