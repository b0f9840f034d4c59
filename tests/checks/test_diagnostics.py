"""Slot 6: rules of the diagnostics check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.diagnostics import GENERATION_S, Diagnostics

NAME = "camera: Frequency"
UNIT = f"diagnostics/{NAME}"
WORDS = {0: "fine", 1: "slow", 2: "no image", 3: "old"}


def said(level: int = 0, age_s: float = 0.5, message: str | None = None, **fields: Any) -> api.DiagnosticFact:
    return api.DiagnosticFact(age_s, level, WORDS.get(level, "odd") if message is None else message, **fields)


def settings(*nodes: str, **entry: Any) -> api.Settings:
    watch = {"name": NAME, **entry}
    ros = {"nodes": [{"name": node} for node in nodes], "diagnostics": {"watch": [watch]}}
    return testing.settings(containers=[{"name": "ros_app"}], ros=ros)


def build(*nodes: str, **entry: Any) -> api.Check:
    (check,) = Diagnostics.build(settings(*nodes, **entry))
    return check


def judge(check: api.Check, world: api.World | None = None, **heard: api.DiagnosticFact) -> api.Result:
    """One run; `heard` by the last word of the status: frequency=... is `camera: Frequency`."""
    diagnostics = {f"camera: {word.capitalize()}": fact for word, fact in heard.items()}
    results = check.run(world or testing.world(ros=testing.FakeRos(diagnostics=diagnostics)))
    assert not isinstance(results, api.Result)
    (result,) = results.values()
    return result


def test_a_status_that_says_ok_is_ok() -> None:
    """Its message is shown."""
    result = judge(build(), frequency=said())
    assert (result.level, result.summary) == (api.Level.OK, "camera: Frequency reports OK: fine")


@pytest.mark.parametrize(
    ("level", "becomes", "condition", "words"),
    [
        (1, api.Level.WARN, "diagnostic_warn", "reports WARN: slow"),
        (2, api.Level.ERROR, "diagnostic_error", "reports ERROR: no image"),
        (3, api.Level.ERROR, "diagnostic_stale", "reports STALE: old"),
        (50, api.Level.ERROR, "diagnostic_error", "reports the unknown level 50: odd"),
    ],
)
def test_a_level_is_taken_over(level: int, becomes: api.Level, condition: str, words: str) -> None:
    """Status, level, message and hardware id are named; a level that does not exist is an error, as for the aggregator."""
    result = judge(build(), frequency=said(level, hardware_id="cam-07", values={"fps": "3.1", "status": "theirs"}))
    assert (result.level, result.condition, result.target) == (becomes, condition, "ros_app")
    assert f"camera: Frequency {words} (hardware id cam-07)" in result.summary
    assert result.values["fps"] == "3.1" and result.values["status"] == NAME
    assert result.brief.startswith("camera: Frequency ")


@pytest.mark.parametrize(
    ("when_stale", "level"), [("error", api.Level.ERROR), ("warn", api.Level.WARN), ("stale", api.Level.STALE)]
)
def test_a_status_that_is_silent_is_stale_as_configured(when_stale: str, level: api.Level) -> None:
    """A publisher that vanished, one that never was, and one that says STALE of itself are the same to the user."""
    check = build(when_stale=when_stale, timeout=5)
    silent = judge(check, frequency=said(age_s=6.0))
    assert (silent.level, silent.condition) == (level, "diagnostic_stale")
    assert "has sent no status for 6.0 s, expected at least every 5.0 s" in silent.summary
    assert judge(check, frequency=said(3)).level is level
    never = judge(check)
    assert (never.level, never.condition, never.brief) == (level, "diagnostic_stale", f"{NAME} not received")


def test_the_worst_of_those_that_match_counts() -> None:
    """A pattern stands for many; the text names the worst, and the others that are not OK."""
    check = build(name="camera: *")
    assert judge(check, one=said(), two=said()).level is api.Level.OK
    result = judge(check, one=said(1), two=said(2), three=said(), four=said(age_s=9.0))
    assert result.level is api.Level.ERROR
    assert result.summary.startswith("camera: Four has sent no status") and "camera: One, camera: Two" in result.summary
    assert (result.values["heard"], result.values["not_ok"]) == (4, 3)


def test_an_error_beats_a_stale_status_that_is_no_fault() -> None:
    """What is known to be wrong wins over what is not known, and that over what is well."""
    check = build(name="camera: *", when_stale="stale")
    assert judge(check, one=said(age_s=9.0), two=said(1)).level is api.Level.WARN
    assert judge(check, one=said(age_s=9.0), two=said()).level is api.Level.STALE


@pytest.mark.parametrize(
    ("pattern", "name", "fits"),
    [
        ("motor[0]: temp", "motor[0]: temp", True),
        ("motor[0]: temp", "motor0: temp", False),
        ("motor?: temp", "motor1: temp", True),
        ("*temp", "motor1: temp", True),
        ("motor1", "motor1: temp", False),
        ("a.c", "abc", False),
    ],
)
def test_only_star_and_question_mark_are_special(pattern: str, name: str, fits: bool) -> None:
    """Brackets and dots are common in names of statuses and mean themselves."""
    world = testing.world(ros=testing.FakeRos(diagnostics={name: said()}))
    assert (judge(build(name=pattern), world).level is api.Level.OK) is fits


def test_a_young_child_proves_no_absence() -> None:
    """Statuses come once a second, and discovery takes seconds."""
    world = testing.world(ros=testing.FakeRos(up_s=2.0))
    assert judge(build(), world).level is api.Level.STALE


def test_breaks_of_the_child_do_not_hide_for_ever_that_a_status_is_missing() -> None:
    """One with a long timeout has been listened for long enough; after a break discovery alone gets its grace."""
    check = build(timeout="300s")
    young, old = (testing.world(ros=testing.FakeRos(up_s=20.0, listened_s=listened_s)) for listened_s in (200.0, 400.0))
    assert judge(check, young).level is api.Level.STALE
    assert judge(check, old).level is api.Level.ERROR


def test_a_near_name_is_offered() -> None:
    """`Freqency` in the configuration is found."""
    world = testing.world(ros=testing.FakeRos(diagnostics={NAME: said()}))
    assert f"Did you mean {NAME}?" in judge(build(name="camera: Freqency"), world).summary


def test_what_was_heard_before_the_container_was_started_anew_need_not_come_again() -> None:
    """Names may be others in the next life; until that life had its grace, nothing is missing."""
    clock, docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app"))
    ros = testing.FakeRos(diagnostics={"camera: Old": said(), "camera: New": said()})
    world = testing.world(clock=clock, docker=docker, ros=ros)
    check = build(name="camera: *")
    assert judge(check, world).level is api.Level.OK
    clock.advance(GENERATION_S)
    ros.change(diagnostics={"camera: Old": said(age_s=6.0), "camera: New": said()})
    assert judge(check, world).level is api.Level.ERROR
    docker.change("ros_app", started_at="2026-02-02T00:00:00Z")
    result = judge(check, world)
    assert result.level is api.Level.STALE and "received yet" in result.summary
    clock.advance(2.0)
    ros.change(diagnostics={"camera: Old": said(age_s=8.0), "camera: New": said()})
    assert judge(check, world).level is api.Level.OK
    clock.advance(20.0)
    ros.change(diagnostics={"camera: Old": said(age_s=28.0), "camera: New": said(age_s=7.0)})
    assert judge(check, world).level is api.Level.ERROR


def test_an_engine_that_does_not_answer_changes_nothing() -> None:
    """The status itself is judged all the same."""
    docker = testing.FakeDocker(testing.container("ros_app"))
    docker.fail()
    world = testing.world(docker=docker, ros=testing.FakeRos(diagnostics={NAME: said(2)}))
    assert judge(build(), world).level is api.Level.ERROR


def test_while_all_is_well_the_engine_is_hardly_asked() -> None:
    """A look at statuses costs no call to Docker."""
    docker = testing.FakeDocker(testing.container("ros_app"))
    world = testing.world(docker=docker, ros=testing.FakeRos(diagnostics={NAME: said()}))
    check = build()
    for _ in range(5):
        judge(check, world)
    assert docker.calls == 1


@pytest.mark.parametrize(
    ("nodes", "entry", "needs"),
    [
        (["/agent_1/camera"], {}, ["nodes/agent_1/camera"]),
        (["/agent_1/camera"], {"name": "/agent_1/camera: x"}, ["nodes/agent_1/camera"]),
        (["/agent_1/camera", "/agent_2/camera"], {}, []),
        (["/agent_1/camera"], {"name": "cam*: x"}, []),
        (["/agent_1/camera"], {"name": "camera"}, []),
        (["/agent_1/camera", "/agent_1/lidar"], {"node": "agent_1/lidar"}, ["nodes/agent_1/lidar"]),
    ],
)
def test_a_status_needs_its_node_and_their_container(nodes: list[str], entry: Any, needs: list[str]) -> None:
    """A dead node is told once, at the node: the configured one, or the one that the status is named after."""
    (unit,) = build(*nodes, **entry).units
    assert list(unit.needs) == ["container/ros_app", "network/ros_app", *needs]
    assert (unit.target, unit.settle_s, unit.grace_s, unit.memory_s) == ("ros_app", 1.5, 8.0, 5.0)


def test_nothing_is_known_without_the_child() -> None:
    """No ROS, or a child that has been silent: STALE, no fault."""
    ros = testing.FakeRos()
    ros.fail("rclpy is not installed")
    assert judge(build(), testing.world(ros=ros)).level is api.Level.STALE
    assert judge(build(), testing.world(ros=testing.FakeRos(age_s=30.0))).level is api.Level.STALE


def test_text_from_outside_is_one_line() -> None:
    """A status cannot write lines of its own into the log."""
    result = judge(build(), frequency=said(2, message="a\n2026 ---- SUCCESS: all is well\x1b[2J", hardware_id="x\ny"))
    assert result.summary.isprintable()


def test_nothing_watched_no_check() -> None:
    """Nothing to judge, nothing built."""
    assert list(Diagnostics.build(testing.settings())) == []
