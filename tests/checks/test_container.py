"""Slot 2: rules of the engine, container and health checks."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.container import LOOP_WINDOW_S, Container, code_in_words
from phm_checks.engine import Engine
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
        ("restarting", "restarting"),
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
        (0, "ended by itself"),
        (1, "error of its own"),
        (126, "cannot be executed"),
        (127, "not found"),
        (134, "SIGABRT"),
        (137, "SIGKILL"),
        (139, "segmentation fault"),
        (143, "SIGTERM"),
        (135, "SIGBUS"),
        (255, "error of its own"),
    ],
)
def test_exit_codes_are_told_in_words(code: int, words: str) -> None:
    """An operator does not know that 139 is a crash in native code."""
    assert words in code_in_words(code)
    result = judge(status="exited", exit_code=code)
    assert words in result.summary
    assert result.brief == f"ros_app exited {code}"


def test_a_container_that_the_engine_keeps_restarting_is_a_warning_while_it_runs() -> None:
    """Three restarts within a minute are told although each look finds it running; later they are forgotten."""
    (check,) = build(Container)
    clock, docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app", restart_count=7))
    world, levels = testing.world(clock=clock, docker=docker), []
    for count in (7, 8, 9, 10):
        docker.change("ros_app", restart_count=count)
        result = check.run(world)
        assert isinstance(result, api.Result)
        levels.append(result.level)
        clock.advance(5)
    clock.advance(LOOP_WINDOW_S)
    after = check.run(world)
    assert isinstance(after, api.Result)
    assert [*levels, after.level] == [api.Level.OK] * 3 + [api.Level.WARN, api.Level.OK]


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
