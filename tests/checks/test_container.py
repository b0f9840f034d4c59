"""Slot 2: rules of the engine, container and health checks."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.checking import plan
from phm.facts import FailedProbe, HealthcheckFact
from phm.tracker import Tracker
from phm_checks._restart_loop import OTHER_STARTS, STABLE_S, WAIT_S
from phm_checks.container import Container, code_in_words
from phm_checks.engine import SETTLE_S, Engine
from phm_checks.health import UNDISTURBED_S, Health


def build(check: type[api.Check], **entry: Any) -> list[api.Check]:
    return list(check.build(testing.settings(containers=[{"name": "ros_app", **entry}])))


def run(check: api.Check, *facts: api.ContainerFact) -> api.Result:
    result = check.run(testing.world(docker=testing.FakeDocker(*facts)))
    assert isinstance(result, api.Result)
    return result


def evaluate(**fields: Any) -> api.Result:
    (check,) = build(Container)
    return run(check, testing.container("ros_app", **fields))


# ------------------------------------------------------------ engine


def test_the_engine_is_checked_only_with_configured_containers() -> None:
    """Without configured containers no unit needs an engine."""
    assert list(Engine.build(testing.settings())) == []
    assert len(build(Engine)) == 1


def test_a_responding_engine_is_ok() -> None:
    """The version in the summary proves the request."""
    assert "27.0" in run(Engine()).summary


@pytest.mark.parametrize(
    ("problem", "condition"),
    [
        (api.CannotTell("no answer within 5 s"), "engine_down"),
        (api.NotPermitted("permission denied"), "engine_refused"),
    ],
)
def test_an_engine_that_does_not_respond_is_an_error(problem: Exception, condition: str) -> None:
    """Only this check reports an unavailable engine as ERROR; a permission error states its remedy."""
    docker = testing.FakeDocker()
    docker.fail(problem)
    result = Engine().run(testing.world(docker=docker))
    assert isinstance(result, api.Result)
    assert (result.level, result.condition) == (api.Level.ERROR, condition)
    assert ("group_add" in result.summary) is (condition == "engine_refused")


def test_a_socket_that_phm_may_not_open_is_named() -> None:
    """The group is missing; nothing is wrong with the engine. For recovery it is down all the same, so no attempt is spent."""
    docker = testing.FakeDocker()
    docker.fail(api.NoAccess("PHM may not open /var/run/docker.sock (permission denied): add the docker group"))
    result = Engine().run(testing.world(docker=docker))
    assert isinstance(result, api.Result)
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "engine_down",
        "no permission for Docker's socket",
    )
    assert "add the docker group" in result.summary
    assert "does not respond" not in result.summary and "systemctl" not in result.summary


def test_a_broken_event_stream_triggers_the_engine_check() -> None:
    """The result must last for a moment: the engine is asked at least twice."""
    (check,) = build(Engine)
    assert check.wakes == {"engine"}
    assert check.units == (api.Unit("engine", settle_s=SETTLE_S),) and check.failures == 2


class Hanging(testing.FakeDocker):
    """An engine that accepts requests and answers none, so that each is given up after its deadline."""

    def __init__(self, clock: testing.FakeClock, takes_s: float) -> None:
        super().__init__()
        self.clock, self.takes_s = clock, takes_s

    def engine(self) -> str:
        self.clock.advance(self.takes_s)
        raise api.CannotTell(f"did not answer within {self.takes_s:g} s")


@pytest.mark.parametrize(("takes_s", "runs"), [(5.0, 2), (0.01, 3)])
def test_an_engine_that_hangs_is_reported_after_two_requests(takes_s: float, runs: int) -> None:
    """Each has lasted for longer than a lost connection may. Refused ones come so fast that a third one must follow."""
    clock = testing.FakeClock()
    (check,), world = build(Engine), testing.world(clock=clock, docker=Hanging(clock, takes_s))
    made = plan.build_plan(testing.settings(containers=[{"name": "ros_app"}]), {"engine": Engine})
    tracker, done = Tracker(made.tracked, made.graph, clock.stamp()), 0
    while not tracker.open_faults():
        started, done = clock.mono(), done + 1
        result = check.run(world)
        assert isinstance(result, api.Result)
        tracker.observe("engine", result, started, clock.stamp())
        clock.advance(0.2)
        tracker.tick(clock.stamp())
    assert done == runs


# ------------------------------------------------------------ container


def test_a_running_container_is_ok() -> None:
    """This check requires only that it runs."""
    assert evaluate().level is api.Level.OK


def test_the_container_depends_on_the_engine_and_is_its_own_target() -> None:
    """A silent engine raises one alarm, and recovery of the container suppresses the container's alarm."""
    (check,) = build(Container)
    assert check.units == (api.Unit("container/ros_app", needs=("engine",), target="ros_app"),)
    assert check.wakes == {"container:ros_app"}


def test_a_container_that_does_not_exist_is_missing() -> None:
    """PHM does not create containers, so the text says what to do."""
    (check,) = build(Container)
    result = run(check)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "missing", "ros_app")
    assert "docker compose up" in result.summary


@pytest.mark.parametrize(
    ("status", "condition"),
    [
        ("created", "not_started"),
        ("exited", "exited"),
        ("paused", "paused"),
        ("dead", "dead"),
        ("removing", "missing"),
        ("unexpected", "not_running"),
    ],
)
def test_each_state_except_running_has_its_own_condition(status: str, condition: str) -> None:
    """Recovery chooses its steps by the condition."""
    result = evaluate(status=status)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, condition, "ros_app")
    assert result.brief.startswith("ros_app ")


def test_an_oom_kill_has_its_own_condition() -> None:
    """Exit code 137 with the OOM flag is a different fault from `docker kill`."""
    result = evaluate(status="exited", exit_code=137, oom_killed=True)
    assert (result.condition, result.brief) == ("oom", "ros_app out of memory")


@pytest.mark.parametrize("code", [0, 143])
def test_an_earlier_oom_kill_inside_is_not_why_a_container_ended(code: int) -> None:
    """The engine keeps its flag when the kernel has killed another process than the first: `docker stop` ends the container later."""
    result = evaluate(status="exited", exit_code=code, oom_killed=True)
    assert (result.condition, result.brief) == ("exited", f"ros_app exited {code}")
    assert "killed a process in it for lack of memory" in result.summary


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, "exited by itself"),
        (1, "application error"),
        (126, "cannot be executed"),
        (127, "not found"),
        (134, "SIGABRT"),
        (137, "SIGKILL"),
        (139, "segmentation fault"),
        (143, "SIGTERM"),
        (135, "SIGBUS"),
        (255, "application error"),
    ],
)
def test_exit_codes_are_explained_in_words(code: int, words: str) -> None:
    """An operator does not know that 139 is a crash in native code."""
    assert words in code_in_words(code)
    result = evaluate(status="exited", exit_code=code)
    assert words in result.summary
    assert result.brief == f"ros_app exited {code}"


class Loop:
    """A container check with a container that a test starts and stops."""

    def __init__(self, **more: Any) -> None:
        (self.check,) = Container.build(testing.settings(containers=[{"name": "ros_app"}], **more))
        self.clock, self.docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app"))
        self.world = testing.world(clock=self.clock, docker=self.docker)
        self.count, self.life = 0, 1

    def observe(self, **fields: Any) -> api.Result:
        if fields:
            self.docker.change("ros_app", **fields)
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result

    def waits(self) -> api.Result:
        """Its process terminated and the engine waits before it restarts it."""
        self.count += 1
        return self.observe(status="restarting", restart_count=self.count, exit_code=139)

    def runs(self, *, by_hand: bool = False) -> api.Result:
        """It has been restarted."""
        self.life += 1
        self.count = 0 if by_hand else self.count
        return self.observe(status="running", started_at=f"t{self.life}", restart_count=self.count)

    def stays(self, seconds: float) -> api.Result:
        self.clock.advance(seconds)
        return self.observe()


def level_and_condition(*results: api.Result) -> list[tuple[str, str]]:
    return [(result.level.name, result.condition) for result in results]


def test_each_result_has_the_start_time_of_the_container() -> None:
    """It shows the tracker that the container was restarted between two checks."""
    loop = Loop()
    first, second = loop.observe(), loop.runs(by_hand=True)
    assert first.level is second.level is api.Level.OK
    assert first.evidence.generation == "id-of-ros_app@2026-01-01T00:00:00.000000001Z"
    assert second.evidence.generation == "id-of-ros_app@t2"
    assert loop.observe(status="exited").evidence.generation == "id-of-ros_app@t2"


def test_one_restart_by_the_engine_is_a_warning_until_the_container_is_stable() -> None:
    """The process did terminate: this is reported even if no check ran in between, and it is not a fault."""
    seen, unseen = Loop(), Loop()
    seen.observe()
    unseen.observe()
    waiting = seen.waits()
    unseen.count += 1
    assert waiting.level is api.Level.STALE and "exit code 139: segmentation fault" in waiting.summary
    for loop in (seen, unseen):
        after = [loop.runs(), loop.stays(STABLE_S - 1), loop.stays(1)]
        assert level_and_condition(*after) == [("WARN", "restarted"), ("WARN", "restarted"), ("OK", "")]


def test_a_container_that_keeps_terminating_is_one_lasting_error() -> None:
    """From the third short run on, with the same text whether it runs or waits during a check."""
    loop = Loop()
    loop.observe()
    early = [result for _ in range(2) for result in (loop.stays(2.0), loop.waits(), loop.runs())]
    assert api.Level.ERROR not in {result.level for result in early}
    for _ in range(6):
        loop.clock.advance(2.0)
        results = [loop.waits(), loop.stays(1.0), loop.runs(), loop.stays(1.0)]
        assert level_and_condition(*results) == [("ERROR", "restarting")] * 4
        assert {result.brief for result in results} == {"ros_app crash loop"}
    assert level_and_condition(loop.stays(STABLE_S)) == [("OK", "")]


def test_restarts_between_two_checks_are_all_counted() -> None:
    """The engine's restart counter includes those that no check observed."""
    loop = Loop()
    loop.observe()
    loop.count = 4
    assert level_and_condition(loop.runs()) == [("ERROR", "restarting")]


def test_a_restart_loop_from_before_the_start_of_phm_is_reported_by_the_first_check() -> None:
    """After a restart of PHM the engine may be in the middle of a back-off of one minute."""
    loop = Loop()
    loop.count = 8
    assert (
        level_and_condition(loop.waits(), loop.stays(59.0), loop.runs(), loop.stays(2.0))
        == [("ERROR", "restarting")] * 4
    )


def test_stale_turns_into_an_error_while_the_engine_backs_off() -> None:
    """The engine waits long only after several restarts, and a lasting STALE would hide a container that is down."""
    loop = Loop()
    loop.observe()
    loop.waits()
    assert level_and_condition(loop.stays(WAIT_S)) == [("ERROR", "restarting")]


def test_after_a_restart_of_phm_a_restart_loop_lasts_until_a_run_is_long() -> None:
    """The container happens to be running then."""
    before, loop = Loop(), Loop()
    before.observe()
    before.count = 4
    reported = before.runs().evidence.subjects
    assert reported == before.waits().evidence.subjects == ("a run without a restart",)
    loop.count = 4
    first, early, late = loop.runs(), loop.stays(STABLE_S - 1), loop.stays(1)
    assert [found.evidence.unobserved_of for found in (first, early, late)] == [reported, reported, ()]
    assert level_and_condition(first, early, late) == [("OK", "")] * 3


def test_long_runs_are_no_restart_loop() -> None:
    """A process that terminates once an hour is restarted by the engine, with one warning each time."""
    loop = Loop()
    loop.observe()
    for _ in range(10):
        loop.stays(3600.0)
        loop.waits()
        assert level_and_condition(loop.runs(), loop.stays(STABLE_S)) == [("WARN", "restarted"), ("OK", "")]


def test_manual_starts_are_a_loop_only_above_the_limit_for_restarts_by_phm() -> None:
    """Each start grants grace to what runs inside: a tool that restarts all the time would hide a fault permanently."""
    loop = Loop()
    loop.observe()
    results = []
    for _ in range(OTHER_STARTS):
        loop.clock.advance(4.0)
        results.append(loop.runs(by_hand=True))
    assert level_and_condition(*results) == [("OK", "")] * (OTHER_STARTS - 1) + [("ERROR", "restarting")]
    assert "6 times" in results[-1].summary
    generous = Loop(recovery={"budget": 8})
    generous.observe()
    results = [generous.runs(by_hand=True) for _ in range(9)]
    assert level_and_condition(*results) == [("OK", "")] * 8 + [("ERROR", "restarting")]


def test_a_manual_start_ends_the_restart_loop() -> None:
    """The operator has intervened, so the count starts from zero."""
    loop = Loop()
    loop.observe()
    loop.count = 5
    assert level_and_condition(loop.runs()) == [("ERROR", "restarting")]
    assert level_and_condition(loop.runs(by_hand=True)) == [("OK", "")]


def test_a_run_shorter_than_the_grace_of_its_nodes_is_short() -> None:
    """With a long `ros.grace` a slow loop would otherwise be hidden by repeated grace."""
    loop = Loop(ros={"grace": "60s"})
    loop.observe()
    for _ in range(3):
        loop.stays(50.0)
        loop.waits()
    assert level_and_condition(loop.runs(), loop.stays(59.0), loop.stays(1.0)) == [("ERROR", "restarting")] * 2 + [
        ("OK", "")
    ]


def test_the_error_text_of_the_engine_is_reported_without_control_characters() -> None:
    """The text is external input."""
    result = evaluate(status="created", error="mount\n\x1b[31mfailed")
    assert "mount [31mfailed" in result.summary


def test_a_silent_engine_is_not_a_fault_of_the_container() -> None:
    """CannotTell propagates to the scheduler, which sets the unit to STALE."""
    (check,) = build(Container)
    docker = testing.FakeDocker()
    docker.fail()
    with pytest.raises(api.CannotTell):
        check.run(testing.world(docker=docker))


# ------------------------------------------------------------ health


@pytest.mark.parametrize(
    ("health", "streak", "level"),
    [
        ("healthy", 0, api.Level.OK),
        ("starting", 0, api.Level.STALE),
        ("unhealthy", 1, api.Level.ERROR),
        ("unhealthy", 0, api.Level.STALE),
    ],
)
def test_docker_health_is_reported_as_level(health: str, streak: int, level: api.Level) -> None:
    """`starting` is not known yet; `unhealthy` is an error, except when the probe has not run since a pause."""
    (check,) = build(Health)
    assert run(check, testing.container("ros_app", health=health, health_streak=streak)).level is level


def test_the_limit_for_starting_depends_on_the_healthcheck() -> None:
    """Its interval, timeout, start period and retries; the text has the limit, and recovery waits for it."""
    (check,) = build(Health)
    slow = HealthcheckFact(interval_s=60.0, timeout_s=10.0, start_period_s=20.0, retries=2)
    assert slow.decides_s == 20.0 + 5.0 + 10.0 + 2 * 70.0
    result = run(check, testing.container("ros_app", health="starting", healthcheck=slow))
    assert result.decides_s == 175.0
    assert "may take 175 s" in result.summary
    assert (
        run(check, testing.container("ros_app", health="unhealthy", health_streak=1, healthcheck=slow)).decides_s
        is None
    )


def test_unhealthy_has_the_maximum_age_of_its_probe() -> None:
    """The engine schedules probes itself: the newest failure came after the previous check and may have taken its timeout."""
    (check,) = build(Health)
    clock, docker = testing.FakeClock(), testing.FakeDocker()
    world = testing.world(clock=clock, docker=docker)
    quick = HealthcheckFact(interval_s=10.0, timeout_s=3.0)

    def age_s(streak: int) -> float:
        docker.put(testing.container("ros_app", health="unhealthy", health_streak=streak, healthcheck=quick))
        result = check.run(world)
        assert isinstance(result, api.Result)
        return result.age_s

    assert age_s(3) == float("inf")
    clock.advance(5.0)
    assert age_s(3) == float("inf")
    clock.advance(2.0)
    assert age_s(4) == 2.0 + 3.0
    clock.advance(5.0)
    assert age_s(4) == 10.0


def test_a_probe_that_hung_for_long_is_evidence_of_its_last_seconds() -> None:
    """An overload that was over seconds before the probe timed out does not explain that it hung for half a minute."""
    (check,) = build(Health)
    clock, docker = testing.FakeClock(), testing.FakeDocker()
    slow = HealthcheckFact(interval_s=3.0, timeout_s=30.0, retries=1)

    def observe(**fields: Any) -> api.Result:
        docker.put(testing.container("ros_app", healthcheck=slow, **fields))
        result = check.run(testing.world(docker=docker, clock=clock))
        assert isinstance(result, api.Result)
        return result

    observe(health="healthy")
    clock.advance(20.0)
    observe(health="healthy")
    clock.advance(10.0)
    assert observe(health="unhealthy", health_streak=1).age_s == 10.0 + UNDISTURBED_S


def test_unhealthy_has_streak_and_last_output() -> None:
    """The last output has the reason; it is reduced to one printable line and truncated."""
    (check,) = build(Health)
    fact = testing.container(
        "ros_app", health="unhealthy", health_streak=4, health_output="curl:\n refused\x00" + "x" * 999
    )
    result = run(check, fact)
    assert (result.condition, result.brief) == ("unhealthy", "ros_app unhealthy")
    assert "failed 4 times" in result.summary and "curl: refused" in result.summary
    assert result.summary.isprintable() and len(result.summary) < 500


def test_a_container_without_healthcheck_is_a_bypass() -> None:
    """With the text of the paper's log; it counts as OK and is never STALE."""
    (check,) = build(Health)
    result = run(check, testing.container("ros_app"))
    assert result.level is api.Level.OK and result.bypass
    assert result.summary == "No health check defined for ros_app."


def test_a_missing_required_healthcheck_is_an_error() -> None:
    """`required` in the configuration is strict."""
    (check,) = build(Health, healthcheck="required")
    assert run(check, testing.container("ros_app")).condition == "healthcheck_missing"


def test_an_ignored_healthcheck_is_not_built() -> None:
    """`ignore` builds no unit."""
    assert build(Health, healthcheck="ignore") == []


@pytest.mark.parametrize("facts", [(), (testing.container("ros_app", status="exited", health="unhealthy"),)])
def test_health_is_stale_while_the_container_does_not_run(facts: tuple[api.ContainerFact, ...]) -> None:
    """Docker keeps the last health of a stopped container, which says nothing about the present."""
    (check,) = build(Health)
    assert run(check, *facts).level is api.Level.STALE
    assert check.units[0].needs == ("container/ros_app",)


PROMPT, KILLED = FailedProbe(1, 0.2), FailedProbe(137, 0.2)


@pytest.mark.parametrize(
    ("probes", "in_time"),
    [
        ((PROMPT, PROMPT), True),
        ((FailedProbe(-1, 30.0), PROMPT, FailedProbe(127, 1.0)), True),
        ((PROMPT,), False),
        ((PROMPT, FailedProbe(1, 1.1)), False),
        ((FailedProbe(-1, 0.1), PROMPT), False),
        ((PROMPT, FailedProbe(1, None)), False),
        ((KILLED, KILLED), False),
        ((), False),
    ],
)
def test_only_probes_that_ended_by_themselves_soon_were_in_time(probes: tuple[FailedProbe, ...], in_time: bool) -> None:
    """Two in a row: neither a timeout, nor a signal, nor a duration that is long or unknown."""
    (check,) = build(Health)
    fact = testing.container("ros_app", health="unhealthy", health_streak=2, failed_probes=probes)
    assert run(check, fact).evidence.in_time is in_time
