"""A health check that hangs: the engine calls the container healthy until the timeout of the run is over, three times by default."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.facts import FailedProbe, HealthcheckFact
from phm_checks._hanging_probe import LEAST_S, RUNS
from phm_checks.health import SETTLE_S, Health

INTERVAL_S, TIMEOUT_S, LOOK_S = 10.0, 30.0, 1.0
PROBE = HealthcheckFact(interval_s=INTERVAL_S, timeout_s=TIMEOUT_S)


class Watched:
    """PHM looks at the container every second."""

    def __init__(self, took_s: tuple[float, ...] = (0.1,), probe: HealthcheckFact = PROBE) -> None:
        (self.check,) = Health.build(testing.settings(containers=[{"name": "ros_app"}]))
        self.clock, self.docker = testing.FakeClock(), testing.FakeDocker()
        self.world = testing.world(clock=self.clock, docker=self.docker)
        fact = testing.container("ros_app", health="healthy", healthcheck=probe)
        self.docker.put(fact)
        self.ends(passed_probes_s=took_s)

    def ends(self, **changes: Any) -> api.Result:
        """A run of the health check has just ended."""
        return self.look(probe_ended=f"at {self.clock.mono()}", **changes)

    def look(self, **changes: Any) -> api.Result:
        self.docker.change("ros_app", **changes)
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result

    def after(self, seconds: float) -> api.Result:
        for _ in range(int(seconds / LOOK_S)):
            self.clock.advance(LOOK_S)
            result = self.look()
        return result


def test_a_run_that_hangs_is_a_warning_until_the_engine_has_decided() -> None:
    """It says what hangs, for how long, and what comes. It opens no fault, and whatever was wrong before is over."""
    watched = Watched()
    assert watched.after(INTERVAL_S + LEAST_S).level is api.Level.OK
    found = watched.after(LOOK_S)
    assert (found.level, found.condition, found.brief) == (
        api.Level.WARN,
        "healthcheck_hangs",
        "ros_app health check hangs",
    )
    assert found.ends_fault and found.settle_s == SETTLE_S
    for words in ("for 16 s", "every 10 s", "timeout of 30 s", "unhealthy", "3 failed runs"):
        assert words in found.summary
    assert watched.ends(health_streak=0).level is api.Level.OK
    watched.after(INTERVAL_S + LEAST_S + LOOK_S)
    unhealthy = watched.ends(health="unhealthy", health_streak=3)
    assert (unhealthy.level, unhealthy.condition) == (api.Level.ERROR, "unhealthy")


def test_a_run_that_the_engine_ended_does_not_end_the_warning() -> None:
    """The next one hangs as well, usually; one that fails or passes by itself does end it."""
    watched = Watched()
    watched.after(INTERVAL_S + TIMEOUT_S)
    hung = FailedProbe(-1, TIMEOUT_S)
    found = watched.ends(health_streak=1, failed_probes=(hung,))
    assert found.level is api.Level.WARN and "1 so far" in found.summary
    assert watched.after(INTERVAL_S).level is api.Level.WARN
    assert watched.ends(health_streak=2, failed_probes=(hung, FailedProbe(1, 0.1))).level is api.Level.OK


def test_a_single_short_timeout_raises_no_warning() -> None:
    """The engine's verdict is as fast."""
    watched = Watched(probe=HealthcheckFact(interval_s=INTERVAL_S, timeout_s=1.0))
    watched.after(INTERVAL_S + 1.0)
    assert watched.ends(health_streak=1, failed_probes=(FailedProbe(-1, 1.0),)).level is api.Level.OK
    assert watched.after(INTERVAL_S + 1.0).level is api.Level.OK


def test_a_slow_health_check_has_more_time() -> None:
    """Several times its longest run of the last ones."""
    watched = Watched(took_s=(0.5, 4.0))
    assert watched.after(INTERVAL_S + RUNS * 4.0).level is api.Level.OK
    assert watched.after(LOOK_S).level is api.Level.WARN


def test_the_start_period_is_not_counted() -> None:
    """A container may be healthy before it is over, and failures in it do not count for the engine either."""
    watched = Watched(probe=HealthcheckFact(INTERVAL_S, TIMEOUT_S, start_period_s=60.0))
    assert watched.after(59.0).level is api.Level.OK
    assert watched.after(LOOK_S).level is api.Level.WARN
    assert watched.look(started_at="later").level is api.Level.OK
    assert watched.after(59.0).level is api.Level.OK


@pytest.mark.parametrize("changes", [{"status": "paused"}, {"health": "starting"}])
def test_it_counts_again_after_a_pause_or_a_start(changes: dict[str, str]) -> None:
    """The engine runs no health check in a paused container, and begins with a new interval."""
    watched = Watched()
    watched.after(INTERVAL_S + LEAST_S)
    assert watched.look(**changes).level is api.Level.STALE
    assert watched.look(status="running", health="healthy").level is api.Level.OK
    assert watched.after(INTERVAL_S + LEAST_S).level is api.Level.OK


def test_time_without_an_answer_of_the_engine_is_not_counted() -> None:
    """An engine that is suspended runs no health check."""
    watched = Watched()
    watched.after(INTERVAL_S)
    watched.docker.problems["ros_app"] = api.NoResponse("no answer")
    for _ in range(60):
        with pytest.raises(api.NoResponse):
            watched.after(LOOK_S)
    watched.docker.problems.clear()
    assert watched.after(LEAST_S).level is api.Level.OK
    assert watched.after(2 * LOOK_S).level is api.Level.WARN


def test_time_in_which_the_engine_is_late_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """It answers after two seconds: it starts health checks late, too."""
    watched = Watched()
    watched.after(INTERVAL_S)
    answer = watched.docker.container

    def late(name: str, young_s: float = 0.0) -> api.ContainerFact | None:
        watched.clock.advance(2.0)
        return answer(name, young_s)

    with monkeypatch.context() as busy:
        busy.setattr(watched.docker, "container", late)
        assert watched.after(20.0).level is api.Level.OK
    assert watched.after(LEAST_S).level is api.Level.OK
    assert watched.after(LOOK_S).level is api.Level.WARN


def test_a_container_without_known_runs_is_not_judged() -> None:
    """Engines that keep no log, e.g. of another vendor."""
    watched = Watched()
    watched.look(probe_ended="", passed_probes_s=())
    assert watched.after(300.0).level is api.Level.OK
