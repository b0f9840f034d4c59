"""A container that was created and not started: its creator may be about to start it."""

from __future__ import annotations

import pytest

from phm import api, testing
from phm.recovery.base import ladder_of
from phm_checks.container import UNSTARTED_ALONE_S, UNSTARTED_S, Container

SETTINGS = testing.settings(containers=[{"name": "ros_app"}])
FAILED = "exec: /nosuch: stat /nosuch: no such file or directory"


class Created:
    """A container check, and the container that it finds."""

    def __init__(self, **fields: object) -> None:
        (self.check,) = Container.build(SETTINGS)
        self.clock = testing.FakeClock()
        self.docker = testing.FakeDocker(testing.container("ros_app", status="created", **fields))
        self.world = testing.world(clock=self.clock, docker=self.docker)

    def after(self, seconds: float, **changes: object) -> api.Result:
        self.clock.advance(seconds)
        if changes:
            self.docker.change("ros_app", **changes)
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result


def test_a_created_container_is_reported_only_after_a_minute() -> None:
    """`docker compose up` creates all containers, and starts each when what it depends on is healthy."""
    found = Created()
    first, later, last = found.after(0.0), found.after(UNSTARTED_S - 1.0), found.after(1.0)
    for result in (first, later):
        assert (result.level, result.condition, result.settle_s) == (api.Level.ERROR, "not_started", UNSTARTED_S)
        assert ladder_of(result.condition, SETTINGS.recovery) == ()
    assert (last.level, last.condition, last.settle_s) == (api.Level.ERROR, "created", None)
    assert ladder_of("created", SETTINGS.recovery) == ("start",)


@pytest.mark.parametrize(
    ("depends_on", "patience_s"), [("", UNSTARTED_ALONE_S), ("db:service_healthy:false", UNSTARTED_S)]
)
def test_who_waits_for_no_other_service_is_reported_earlier(depends_on: str, patience_s: float) -> None:
    """A start by PHM then does not come before the health check of another one."""
    found = Created(depends_on=depends_on)
    first, later, last = found.after(0.0), found.after(patience_s - 1.0), found.after(1.0)
    assert (first.condition, first.settle_s) == (later.condition, later.settle_s) == ("not_started", patience_s)
    assert (last.condition, last.settle_s) == ("created", None)


def test_a_start_that_failed_is_reported_immediately() -> None:
    """The engine leaves it `created` and keeps the error (seen with Docker 20.10, which sends no event then)."""
    for found in (Created(error=FAILED), Created()):
        result = found.after(5.0, error=FAILED)
        assert (result.condition, result.settle_s) == ("created", None) and "no such file" in result.summary


def test_each_container_has_its_minute() -> None:
    """It was created again, or was started and is a new one later."""
    found = Created()
    found.after(0.0)
    assert found.after(UNSTARTED_S - 1.0, id="another").condition == "not_started"
    assert found.after(2.0).condition == "not_started"
    assert found.after(1.0, status="running").level is api.Level.OK
    assert found.after(UNSTARTED_S, status="created", id="third").condition == "not_started"


def test_the_minute_begins_when_it_was_created() -> None:
    """Also beside an outage of the engine, and over a restart of PHM, which keeps what it knows of the clock."""
    found = Created()
    found.docker.change("ros_app", status="running", id="before")
    assert found.after(0.0).level is api.Level.OK
    created = found.clock.utc() + 5.0
    found.docker.problems["ros_app"] = api.NoResponse("no answer")
    with pytest.raises(api.NoResponse):
        found.after(20.0)
    found.docker.problems.clear()
    assert found.after(0.0, status="created", id="new", created_at=created).condition == "not_started"
    assert found.after(UNSTARTED_S - 16.0).condition == "not_started"
    restarted = Created()
    restarted.world, restarted.clock, restarted.docker = found.world, found.clock, found.docker
    assert restarted.after(0.0).condition == "not_started"
    assert restarted.after(1.0).condition == found.after(0.0).condition == "created"


@pytest.mark.parametrize("step_s", [-7200.0, 7200.0])
def test_a_clock_that_is_set_does_not_shorten_the_minute(step_s: float) -> None:
    """A computer without a battery-backed clock gets the time while containers are created."""
    found = Created(created_at=None)
    created = found.clock.utc()
    found.clock.advance(1.0)
    found.clock.jump_utc(step_s)
    assert found.after(0.0, created_at=created).condition == "not_started"
    assert found.after(UNSTARTED_S - 1.5).condition == "not_started"


@pytest.mark.parametrize("apart_s", [-7200.0, 7200.0])
def test_a_clock_of_the_engine_that_differs_does_not_shorten_the_minute(apart_s: float) -> None:
    """PHM saw a moment ago that this container did not exist."""
    found = Created()
    found.docker.change("ros_app", status="running", id="before")
    found.after(100.0)
    result = found.after(5.0, status="created", id="new", created_at=found.clock.utc() + apart_s)
    assert result.condition == "not_started"
    assert found.after(UNSTARTED_S - 6.0).condition == "not_started"
