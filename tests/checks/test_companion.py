"""Slot 1: rules of the companion check."""

from __future__ import annotations

from phm import api, testing
from phm_checks.companion import Companion


def check() -> api.Check:
    (one,) = Companion.build(testing.settings())
    return one


def run(companion_check: api.Check, world: api.World) -> api.Result:
    result = companion_check.run(world)
    assert isinstance(result, api.Result)
    return result


def test_a_phm_without_problems_is_ok() -> None:
    """No overdue checks, lost events or problems."""
    result = run(check(), testing.world())
    assert result.level is api.Level.OK
    assert result.values["uptime_s"] == 60.0


def test_problems_of_phm_itself_are_warnings() -> None:
    """One summary lists overdue checks, lost events and problems."""
    daemon = testing.FakeSelf(
        overdue=("files/ros_app",), dropped={"mavlink": 3, "log": 0}, problems=("log: no space left",)
    )
    result = run(check(), testing.world(daemon=daemon))
    assert (result.level, result.condition) == (api.Level.WARN, "check_overdue")
    for part in ("files/ros_app", "mavlink 3", "no space left"):
        assert part in result.summary
    assert "log 0" not in result.summary


def test_lost_links_are_not_reported_here() -> None:
    """A closed link and a lost ground station have their own checks, which report them once."""
    links = testing.FakeLinks(gcs_age_s=60.0, links=(api.LinkFact("radio", False, "no such device"),))
    assert run(check(), testing.world(links=links)).level is api.Level.OK


def test_a_crash_is_reported_for_a_limited_time() -> None:
    """PHM was killed and restarted: a warning, only for as long as a ground station needs to receive it."""
    daemon = testing.FakeSelf(uptime_s=2.0, ended_badly=True)
    result = run(check(), testing.world(daemon=daemon))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "phm_restarted", "PHM was restarted")
    daemon.change(uptime_s=60.0)
    assert run(check(), testing.world(daemon=daemon)).level is api.Level.OK


def test_a_suspension_is_reported_for_a_limited_time() -> None:
    """PHM was suspended and resumed: the text has the time without monitoring."""
    daemon = testing.FakeSelf(suspended_s=4.2, suspended_ago_s=1.0)
    result = run(check(), testing.world(daemon=daemon))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "phm_suspended", "PHM suspended 4 s")
    assert "was it stopped or paused" in result.summary
    daemon.change(suspended_s=0.42, was_stopped=True)
    result = run(check(), testing.world(daemon=daemon))
    assert (result.condition, result.brief) == ("phm_suspended", "PHM suspended 0.4 s")
    assert "SIGSTOP" in result.summary
    daemon.change(suspended_ago_s=40.0)
    assert run(check(), testing.world(daemon=daemon)).level is api.Level.OK
