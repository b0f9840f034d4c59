"""Slot 2: rules of the engine, container and health checks."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm.facts import HealthcheckFact
from phm_checks._restart_loop import OTHER_STARTS, STABLE_S, WAIT_S
from phm_checks.container import Container, code_in_words
from phm_checks.engine import SETTLE_S, Engine
from phm_checks.health import Health


def build(check: type[api.Check], **entry: Any) -> list[api.Check]:
    return list(check.build(testing.settings(containers=[{"name": "ros_app", **entry}])))


def run(check: api.Check, *facts: api.ContainerFact) -> api.Result:
    result = check.run(testing.world(docker=testing.FakeDocker(*facts)))
    assert isinstance(result, api.Result)
    return result


def judge(**fields: Any) -> api.Result:
    (check,) = build(Container)
    return run(check, testing.container("ros_app", **fields))


# ------------------------------------------------------------ engine


def test_the_engine_is_judged_only_when_containers_are() -> None:
    """Without configured containers nobody needs an engine."""
    assert list(Engine.build(testing.settings())) == []
    assert len(build(Engine)) == 1


def test_an_answering_engine_is_ok() -> None:
    """The version shows that it was asked."""
    assert "27.0" in run(Engine()).summary


@pytest.mark.parametrize(
    ("problem", "condition"),
    [
        (api.CannotTell("no answer within 5 s"), "engine_down"),
        (api.NotPermitted("permission denied"), "engine_refused"),
    ],
)
def test_an_engine_that_does_not_answer_is_the_fault_itself(problem: Exception, condition: str) -> None:
    """Here alone not answering is an ERROR, and a refusal names its remedy."""
    docker = testing.FakeDocker()
    docker.fail(problem)
    result = Engine().run(testing.world(docker=docker))
    assert isinstance(result, api.Result)
    assert (result.level, result.condition) == (api.Level.ERROR, condition)
    assert ("group_add" in result.summary) is (condition == "engine_refused")


def test_the_engine_is_looked_at_when_its_event_stream_breaks() -> None:
    """And what is found must last for a moment: it is asked twice at least."""
    (check,) = build(Engine)
    assert check.wakes == {"engine"}
    assert check.units == (api.Unit("engine", settle_s=SETTLE_S),) and check.failures == 2


# ------------------------------------------------------------ container


def test_a_running_container_is_ok() -> None:
    """Running is all this check asks for."""
    assert judge().level is api.Level.OK


def test_the_container_needs_the_engine_and_is_its_own_target() -> None:
    """A silent engine is one alarm, and a repair of the container holds its alarm."""
    (check,) = build(Container)
    assert check.units == (api.Unit("container/ros_app", needs=("engine",), target="ros_app"),)
    assert check.wakes == {"container:ros_app"}


def test_no_such_container_is_missing() -> None:
    """PHM does not create containers, so it says who must."""
    (check,) = build(Container)
    result = run(check)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "missing", "ros_app")
    assert "docker compose up" in result.summary


@pytest.mark.parametrize(
    ("status", "condition"),
    [
        ("created", "created"),
        ("exited", "exited"),
        ("paused", "paused"),
        ("dead", "dead"),
        ("removing", "missing"),
        ("strange", "not_running"),
    ],
)
def test_each_state_but_running_is_an_error_of_its_own(status: str, condition: str) -> None:
    """Recovery chooses its steps by the condition, so each state has one."""
    result = judge(status=status)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, condition, "ros_app")
    assert result.brief.startswith("ros_app ")


def test_killed_for_lack_of_memory_is_told_as_such() -> None:
    """137 with the OOM mark is another fault than a `docker kill`."""
    result = judge(status="exited", exit_code=137, oom_killed=True)
    assert (result.condition, result.brief) == ("oom", "ros_app out of memory")


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
def test_exit_codes_are_told_in_words(code: int, words: str) -> None:
    """An operator does not know that 139 is a crash in native code."""
    assert words in code_in_words(code)
    result = judge(status="exited", exit_code=code)
    assert words in result.summary
    assert result.brief == f"ros_app exited {code}"


class Loop:
    """One container check, and a container that a test lets live and end."""

    def __init__(self, **more: Any) -> None:
        (self.check,) = Container.build(testing.settings(containers=[{"name": "ros_app"}], **more))
        self.clock, self.docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app"))
        self.world = testing.world(clock=self.clock, docker=self.docker)
        self.count, self.life = 0, 1

    def look(self, **fields: Any) -> api.Result:
        if fields:
            self.docker.change("ros_app", **fields)
        result = self.check.run(self.world)
        assert isinstance(result, api.Result)
        return result

    def waits(self) -> api.Result:
        """Its process ended and the engine waits to restart it."""
        self.count += 1
        return self.look(status="restarting", restart_count=self.count, exit_code=139)

    def runs(self, *, by_hand: bool = False) -> api.Result:
        """It has been started again."""
        self.life += 1
        self.count = 0 if by_hand else self.count
        return self.look(status="running", started_at=f"t{self.life}", restart_count=self.count)

    def stays(self, seconds: float) -> api.Result:
        self.clock.advance(seconds)
        return self.look()


def told(*results: api.Result) -> list[tuple[str, str]]:
    return [(result.level.name, result.condition) for result in results]


def test_every_result_names_the_life_that_was_seen() -> None:
    """By it the tracker knows that a container was started again between two looks."""
    loop = Loop()
    first, second = loop.look(), loop.runs(by_hand=True)
    assert first.level is second.level is api.Level.OK
    assert first.evidence.generation == "id-of-ros_app@2026-01-01T00:00:00.000000001Z"
    assert second.evidence.generation == "id-of-ros_app@t2"
    assert loop.look(status="exited").evidence.generation == "id-of-ros_app@t2"


def test_one_restart_by_the_engine_is_a_warning_until_it_has_stayed() -> None:
    """The process did end: that is told whether or not a look fell between its lives, and it is no fault."""
    seen, unseen = Loop(), Loop()
    seen.look()
    unseen.look()
    waiting = seen.waits()
    unseen.count += 1
    assert waiting.level is api.Level.STALE and "exit code 139: segmentation fault" in waiting.summary
    for loop in (seen, unseen):
        after = [loop.runs(), loop.stays(STABLE_S - 1), loop.stays(1)]
        assert told(*after) == [("WARN", "restarted"), ("WARN", "restarted"), ("OK", "")]


def test_a_container_that_ends_again_and_again_is_one_error_that_lasts() -> None:
    """From the third short life on, whether it runs or waits at a look, in the same words for the operator."""
    loop = Loop()
    loop.look()
    early = [result for _ in range(2) for result in (loop.stays(2.0), loop.waits(), loop.runs())]
    assert api.Level.ERROR not in {result.level for result in early}
    for _ in range(6):
        loop.clock.advance(2.0)
        results = [loop.waits(), loop.stays(1.0), loop.runs(), loop.stays(1.0)]
        assert told(*results) == [("ERROR", "restarting")] * 4
        assert {result.brief for result in results} == {"ros_app crash loop"}
    assert told(loop.stays(STABLE_S)) == [("OK", "")]


def test_restarts_between_two_looks_are_all_counted() -> None:
    """The engine's counter tells of lives that nobody saw."""
    loop = Loop()
    loop.look()
    loop.count = 4
    assert told(loop.runs()) == [("ERROR", "restarting")]


def test_a_loop_that_was_there_before_phm_is_told_at_the_first_look() -> None:
    """After a restart of PHM the engine may be in the middle of a wait of a minute."""
    loop = Loop()
    loop.count = 8
    assert told(loop.waits(), loop.stays(59.0), loop.runs(), loop.stays(2.0)) == [("ERROR", "restarting")] * 4


def test_not_knowing_does_not_last_while_the_engine_waits() -> None:
    """The engine waits long only after several restarts, and a STALE that lasts would hide a container that is down."""
    loop = Loop()
    loop.look()
    loop.waits()
    assert told(loop.stays(WAIT_S)) == [("ERROR", "restarting")]


def test_lives_that_are_not_short_are_no_loop() -> None:
    """A process that ends once an hour is restarted by the engine, with a warning each time."""
    loop = Loop()
    loop.look()
    for _ in range(10):
        loop.stays(3600.0)
        loop.waits()
        assert told(loop.runs(), loop.stays(STABLE_S)) == [("WARN", "restarted"), ("OK", "")]


def test_starts_by_hand_are_no_loop_until_there_are_more_than_phm_itself_may_make() -> None:
    """Each start gives grace to what runs inside: a tool that restarts all the time would hide for ever what is broken."""
    loop = Loop()
    loop.look()
    results = []
    for _ in range(OTHER_STARTS):
        loop.clock.advance(4.0)
        results.append(loop.runs(by_hand=True))
    assert told(*results) == [("OK", "")] * (OTHER_STARTS - 1) + [("ERROR", "restarting")]
    assert "6 times" in results[-1].summary
    generous = Loop(recovery={"budget": 8})
    generous.look()
    results = [generous.runs(by_hand=True) for _ in range(9)]
    assert told(*results) == [("OK", "")] * 8 + [("ERROR", "restarting")]


def test_a_start_by_hand_ends_the_engines_loop() -> None:
    """Somebody has done something about it: it is judged anew."""
    loop = Loop()
    loop.look()
    loop.count = 5
    assert told(loop.runs()) == [("ERROR", "restarting")]
    assert told(loop.runs(by_hand=True)) == [("OK", "")]


def test_a_life_shorter_than_the_grace_of_what_runs_inside_is_short() -> None:
    """With a long `ros.grace` a slow loop would otherwise hide behind grace that is given again and again."""
    loop = Loop(ros={"grace": "60s"})
    loop.look()
    for _ in range(3):
        loop.stays(50.0)
        loop.waits()
    assert told(loop.runs(), loop.stays(59.0), loop.stays(1.0)) == [("ERROR", "restarting")] * 2 + [("OK", "")]


def test_an_engine_error_text_is_told_without_control_characters() -> None:
    """What the engine says comes from outside."""
    result = judge(status="created", error="mount\n\x1b[31mfailed")
    assert "mount [31mfailed" in result.summary


def test_an_engine_that_is_silent_is_no_fault_of_the_container() -> None:
    """CannotTell goes through to the engine of PHM, which makes it STALE."""
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
def test_docker_health_is_taken_over(health: str, streak: int, level: api.Level) -> None:
    """Starting is not known yet; unhealthy is an error, but not the engine's word for `not run since a pause`."""
    (check,) = build(Health)
    assert run(check, testing.container("ros_app", health=health, health_streak=streak)).level is level


def test_how_long_docker_may_say_starting_depends_on_the_healthcheck() -> None:
    """Its interval, time-out, start period and retries; an operator reads it, and recovery waits for it."""
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


def test_unhealthy_says_how_old_its_probe_may_be() -> None:
    """The engine probes in its own time: the newest failure came after the look before, and may have taken its time-out."""
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


def test_unhealthy_tells_streak_and_last_output() -> None:
    """The last output is where the reason stands; it is made one printable line and cut."""
    (check,) = build(Health)
    fact = testing.container(
        "ros_app", health="unhealthy", health_streak=4, health_output="curl:\n refused\x00" + "x" * 999
    )
    result = run(check, fact)
    assert (result.condition, result.brief) == ("unhealthy", "ros_app unhealthy")
    assert "failed 4 times" in result.summary and "curl: refused" in result.summary
    assert result.summary.isprintable() and len(result.summary) < 500


def test_no_healthcheck_is_a_bypass() -> None:
    """In the words of the paper's log; it counts as OK and never stays unknown."""
    (check,) = build(Health)
    result = run(check, testing.container("ros_app"))
    assert result.level is api.Level.OK and result.bypass
    assert result.summary == "No health check defined for ros_app."


def test_no_healthcheck_is_an_error_when_required() -> None:
    """A configuration that requires one means it."""
    (check,) = build(Health, healthcheck="required")
    assert run(check, testing.container("ros_app")).condition == "healthcheck_missing"


def test_an_ignored_healthcheck_is_not_built() -> None:
    """Ignore means no unit at all."""
    assert build(Health, healthcheck="ignore") == []


@pytest.mark.parametrize("facts", [(), (testing.container("ros_app", status="exited", health="unhealthy"),)])
def test_health_is_not_known_while_the_container_does_not_run(facts: tuple[api.ContainerFact, ...]) -> None:
    """Docker keeps the last health of a stopped container; it says nothing about now."""
    (check,) = build(Health)
    assert run(check, *facts).level is api.Level.STALE
    assert check.units[0].needs == ("container/ros_app",)
