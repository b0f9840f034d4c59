"""Slot 6: rules of the diagnostics check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.diagnostics import GENERATION_S, Diagnostics

NAME = "camera: Frequency"
UNIT = f"diagnostics/{NAME}"
WORDS = {0: "fine", 1: "slow", 2: "no image", 3: "old"}


def status(level: int = 0, age_s: float = 0.5, message: str | None = None, **fields: Any) -> api.DiagnosticFact:
    return api.DiagnosticFact(age_s, level, WORDS.get(level, "odd") if message is None else message, **fields)


def settings(*nodes: str, **entry: Any) -> api.Settings:
    watch = {"name": NAME, **entry}
    ros = {"nodes": [{"name": node} for node in nodes], "diagnostics": {"watch": [watch]}}
    return testing.settings(containers=[{"name": "ros_app"}], ros=ros)


def build(*nodes: str, **entry: Any) -> api.Check:
    (check,) = Diagnostics.build(settings(*nodes, **entry))
    return check


def evaluate(check: api.Check, world: api.World | None = None, **statuses: api.DiagnosticFact) -> api.Result:
    """Run the check once; the keyword is the last word of the status name: frequency=... is `camera: Frequency`."""
    diagnostics = {f"camera: {word.capitalize()}": fact for word, fact in statuses.items()}
    results = check.run(world or testing.world(ros=testing.FakeRos(diagnostics=diagnostics)))
    assert not isinstance(results, api.Result)
    (result,) = results.values()
    return result


def test_a_status_of_level_ok_is_ok() -> None:
    """Its message is shown."""
    result = evaluate(build(), frequency=status())
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
def test_the_level_of_a_status_becomes_the_level_of_the_unit(
    level: int, becomes: api.Level, condition: str, words: str
) -> None:
    """Status, level, message and hardware id are named; an undefined level is an ERROR, as in the aggregator."""
    result = evaluate(build(), frequency=status(level, hardware_id="cam-07", values={"fps": "3.1", "status": "theirs"}))
    assert (result.level, result.condition, result.target) == (becomes, condition, "ros_app")
    assert f"camera: Frequency {words} (hardware id cam-07)" in result.summary
    assert result.values["fps"] == "3.1" and result.values["status"] == NAME
    assert result.brief.startswith("camera: Frequency ")


@pytest.mark.parametrize(
    ("when_stale", "level"), [("error", api.Level.ERROR), ("warn", api.Level.WARN), ("stale", api.Level.STALE)]
)
def test_a_silent_status_has_the_configured_level(when_stale: str, level: api.Level) -> None:
    """A publisher that vanished, one that never existed and one that reports STALE are the same to the user."""
    check = build(when_stale=when_stale, timeout=5)
    silent = evaluate(check, frequency=status(age_s=6.0))
    assert (silent.level, silent.condition) == (level, "diagnostic_stale")
    assert "has sent no status for 6.0 s, expected at least every 5.0 s" in silent.summary
    assert evaluate(check, frequency=status(3)).level is level
    never = evaluate(check)
    assert (never.level, never.condition, never.brief) == (level, "diagnostic_stale", f"{NAME} not received")


def test_the_worst_of_all_matching_statuses_counts() -> None:
    """A pattern matches many statuses; the text names the worst and the others that are not OK."""
    check = build(name="camera: *")
    assert evaluate(check, one=status(), two=status()).level is api.Level.OK
    result = evaluate(check, one=status(1), two=status(2), three=status(), four=status(age_s=9.0))
    assert result.level is api.Level.ERROR
    assert result.summary.startswith("camera: Four has sent no status") and "camera: One, camera: Two" in result.summary
    assert (result.values["received"], result.values["not_ok"]) == (4, 3)


def test_an_error_has_priority_over_a_stale_status() -> None:
    """A known fault has priority over an unknown status, and that over an OK one."""
    check = build(name="camera: *", when_stale="stale")
    assert evaluate(check, one=status(age_s=9.0), two=status(1)).level is api.Level.WARN
    assert evaluate(check, one=status(age_s=9.0), two=status()).level is api.Level.STALE


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
    """Brackets and dots are common in status names and are literal."""
    world = testing.world(ros=testing.FakeRos(diagnostics={name: status()}))
    assert (evaluate(build(name=pattern), world).level is api.Level.OK) is fits


def test_a_new_ros_child_proves_no_absence() -> None:
    """Statuses arrive once a second, and discovery takes seconds."""
    world = testing.world(ros=testing.FakeRos(up_s=2.0))
    assert evaluate(build(), world).level is api.Level.STALE


def test_restarts_of_the_ros_child_do_not_hide_a_missing_status_permanently() -> None:
    """A status with a long timeout has been awaited long enough; after a restart only discovery gets its grace."""
    check = build(timeout="300s")
    young, old = (testing.world(ros=testing.FakeRos(up_s=20.0, listened_s=listened_s)) for listened_s in (200.0, 400.0))
    assert evaluate(check, young).level is api.Level.STALE
    assert evaluate(check, old).level is api.Level.ERROR


@pytest.mark.parametrize("ended", ["received", "patience", "container restarted"])
def test_a_new_ros_child_does_not_end_what_it_has_not_received(ended: str) -> None:
    """Of two statuses that match, the one that is OK may arrive first."""
    clock, docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app"))
    ros = testing.FakeRos(diagnostics={"camera: One": status(), "camera: Two": status(2, hardware_id="b")})
    world = testing.world(clock=clock, docker=docker, ros=ros)
    check = build(name="camera: *")
    assert evaluate(check, world).evidence.subjects == ("camera: Two (hardware id b)",)
    clock.advance(GENERATION_S)
    ros.change(up_s=1.0, diagnostics={"camera: One": status()})
    result = evaluate(check, world)
    assert result.level is api.Level.STALE and "camera: Two (hardware id b): not received again yet" in result.summary
    ros.change(up_s=2.0)
    assert evaluate(check, world).level is api.Level.STALE
    if ended == "received":
        ros.change(diagnostics={"camera: One": status(), "camera: Two": status(hardware_id="b")})
    elif ended == "patience":
        ros.change(up_s=8.0)
    else:
        clock.advance(GENERATION_S)
        docker.change("ros_app", started_at="2026-02-02T00:00:00Z")
        evaluate(check, world)
        clock.advance(1.0)
    assert evaluate(check, world).level is api.Level.OK


def test_after_a_restart_of_phm_an_early_ok_covers_what_was_received() -> None:
    """What failed before may not have been received yet; after the patience the OK is about all."""
    early, late = (testing.world(ros=testing.FakeRos(up_s=s, diagnostics={NAME: status()})) for s in (7.0, 8.0))
    check = build(name="camera: *")
    assert [evaluate(check, world).evidence.subjects for world in (early, late)] == [(NAME,), None]


def test_a_similar_name_is_suggested() -> None:
    """It helps to find `Freqency` in the configuration."""
    world = testing.world(ros=testing.FakeRos(diagnostics={NAME: status()}))
    assert f"Did you mean {NAME}?" in evaluate(build(name="camera: Freqency"), world).summary


def test_statuses_from_before_a_container_restart_need_not_return() -> None:
    """Names may differ after the restart; nothing is missing until the new generation has had its grace."""
    clock, docker = testing.FakeClock(), testing.FakeDocker(testing.container("ros_app"))
    ros = testing.FakeRos(diagnostics={"camera: Old": status(), "camera: New": status()})
    world = testing.world(clock=clock, docker=docker, ros=ros)
    check = build(name="camera: *")
    assert evaluate(check, world).level is api.Level.OK
    clock.advance(GENERATION_S)
    ros.change(diagnostics={"camera: Old": status(age_s=6.0), "camera: New": status()})
    assert evaluate(check, world).level is api.Level.ERROR
    docker.change("ros_app", started_at="2026-02-02T00:00:00Z")
    result = evaluate(check, world)
    assert result.level is api.Level.STALE and "received yet" in result.summary
    clock.advance(2.0)
    ros.change(diagnostics={"camera: Old": status(age_s=8.0), "camera: New": status()})
    assert evaluate(check, world).level is api.Level.OK
    clock.advance(20.0)
    ros.change(diagnostics={"camera: Old": status(age_s=28.0), "camera: New": status(age_s=7.0)})
    assert evaluate(check, world).level is api.Level.ERROR


def test_an_engine_that_does_not_respond_changes_nothing() -> None:
    """The status itself is still evaluated."""
    docker = testing.FakeDocker(testing.container("ros_app"))
    docker.fail()
    world = testing.world(docker=docker, ros=testing.FakeRos(diagnostics={NAME: status(2)}))
    assert evaluate(build(), world).level is api.Level.ERROR


def test_while_all_statuses_are_ok_the_engine_is_rarely_polled() -> None:
    """Reading statuses needs no Docker request."""
    docker = testing.FakeDocker(testing.container("ros_app"))
    world = testing.world(docker=docker, ros=testing.FakeRos(diagnostics={NAME: status()}))
    check = build()
    for _ in range(5):
        evaluate(check, world)
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
def test_a_status_depends_on_its_node_and_its_container(nodes: list[str], entry: Any, needs: list[str]) -> None:
    """A dead node is reported once, by its own unit: the configured node, or the one in the name of the status."""
    (unit,) = build(*nodes, **entry).units
    assert list(unit.needs) == ["container/ros_app", "network/ros_app", *needs]
    assert (unit.target, unit.settle_s, unit.grace_s, unit.memory_s) == ("ros_app", 1.5, 8.0, 5.0)


def test_without_the_ros_child_the_status_is_stale() -> None:
    """No ROS, or a silent child process: STALE without a fault."""
    ros = testing.FakeRos()
    ros.fail("rclpy is not installed")
    assert evaluate(build(), testing.world(ros=ros)).level is api.Level.STALE
    assert evaluate(build(), testing.world(ros=testing.FakeRos(age_s=30.0))).level is api.Level.STALE


def test_external_text_is_reduced_to_one_line() -> None:
    """A status cannot write its own lines into the log."""
    result = evaluate(
        build(), frequency=status(2, message="a\n2026 ---- SUCCESS: all is OK\x1b[2J", hardware_id="x\ny")
    )
    assert result.summary.isprintable()


def test_without_configured_statuses_no_check_is_built() -> None:
    """There is nothing to check."""
    assert list(Diagnostics.build(testing.settings())) == []
