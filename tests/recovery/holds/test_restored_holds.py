"""Holds over a restart of PHM and a reboot of the machine."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Phase, Stamp
from phm.probes.docker_event import DockerEvent
from phm.recovery.holds.hold_registry import OPERATOR, WINDOW, Hold, HoldRegistry
from phm.recovery.holds.hold_service import HoldInputs, HoldService
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.persistence.state_codec import InvalidState, decode, encode
from phm.recovery.safety.armed_state import ArmedState as ArmedState, ArmedStatus, LastArmedState
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from tests.recovery.holds.scene import BY, LONG_BACKOFF, Scene, stopped


def test_a_hold_survives_a_restart_of_phm(scenes: Any, tmp_path: Path) -> None:
    """With the same end."""
    first = scenes(tmp_path)
    first.hold(for_s=100)
    first.agent.rest(5)
    first.agent.stop()
    first.clock.advance(20)
    second = scenes(tmp_path, first.clock)
    hold = second.service.snapshot()[0]
    assert hold["reason"] == "new firmware" and 70 < hold["left_s"] < 76
    second.agent.bad = {"container/app": "broken"}
    second.agent.rest(60)
    assert second.agent.opened() == []
    second.agent.until(lambda: second.agent.opened() == ["container/app"], "the end of the hold")


def test_recovery_requests_no_checks_while_on_hold(
    scenes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault from before a restart of PHM: results on hold do not count, and a new run is requested afterwards."""
    first = scenes(tmp_path, **LONG_BACKOFF)
    first.agent.behave = lambda key, context, fault: None
    first.agent.bad = {"container/app": "broken"}
    first.agent.until(lambda: first.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    first.hold(for_s=100)
    first.agent.rest(5)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, bad={"container/app": "broken"}, **LONG_BACKOFF)
    looks: list[str] = []
    monkeypatch.setattr(second.agent.pipeline, "recheck", lambda *units: looks.extend(units))
    second.agent.rest(60)
    assert looks == []
    second.agent.until(lambda: looks, "the fresh run")
    second.agent.until(lambda: Phase.STARTED in second.agent.steps(), "the next attempt")


def test_a_stop_that_ended_before_phms_start_has_no_hold(scenes: Any, tmp_path: Path) -> None:
    """The container was started while PHM did not run, so there is no event; if it is still stopped, its hold
    continues.
    """
    first = scenes(tmp_path)
    stopped(first, "app")
    stopped(first, "cam")
    first.agent.bad = {"container/app": "exited", "container/cam": "exited"}
    first.agent.rest(10)
    first.agent.stop()
    first.containers.start("app")
    second = scenes(tmp_path, first.clock, containers=first.containers)
    assert [hold["container"] for hold in second.service.snapshot()] == ["cam"]


def test_an_advised_stop_stays_advised_over_a_restart(scenes: Any, tmp_path: Path) -> None:
    """Until the container is started."""
    first = scenes(tmp_path, on_manual_stop="advise")
    stopped(first, "cam")
    first.agent.until(lambda: first.agent.steps("cam") == [Phase.ADVISED], "the advice")
    first.agent.stop()
    first.containers.end("cam")
    second = scenes(tmp_path, first.clock, containers=first.containers, on_manual_stop="advise")
    second.agent.bad = {"container/cam": "exited"}
    second.agent.rest(20)
    assert second.agent.runs == []


def test_a_released_window_stays_released_over_a_restart(scenes: Any, tmp_path: Path) -> None:
    """An occurrence is one hold, also for the next PHM."""
    windows = [{"when": "02:00-02:10", "container": "cam"}]
    first = scenes(tmp_path, maintenance=windows)
    first.clock.jump_utc(1795312860.0 - first.clock.utc())  # 2026-11-22 02:01 UTC
    first.agent.rest(10)
    assert first.changes() == [("cam", True)]
    first.service.release("cam", BY)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, maintenance=windows)
    second.agent.rest(20)
    assert second.changes() == [] and second.service.snapshot() == []


def test_a_window_that_was_released_before_an_upgrade_stays_released(scenes: Any) -> None:
    """PHM 0.2.0 kept the beginning of an occurrence without its end."""
    scene = scenes(maintenance=[{"when": "02:00-02:10", "container": "cam"}])
    scene.holds.finish("cam", "2026-11-22T02:00Z")
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())  # 2026-11-22 02:01 UTC
    scene.agent.rest(20)
    assert scene.changes() == [] and scene.service.snapshot() == []


def test_a_window_removed_from_the_configuration_ends(scenes: Any, tmp_path: Path) -> None:
    """Its saved hold ends, too."""
    first = scenes(tmp_path, maintenance=[{"when": "02:00-02:10", "container": "cam"}])
    first.clock.jump_utc(1795312860.0 - first.clock.utc())  # 2026-11-22 02:01 UTC
    first.agent.rest(10)
    first.agent.stop()
    second = scenes(tmp_path, first.clock)
    second.agent.rest(20)
    assert second.changes() == [("cam", False)] and second.service.snapshot() == []


def ends(scene: Scene) -> list[int]:
    """When holds end, in minutes after the hour."""
    left_s = [hold.until - scene.clock.mono() for hold in scene.holds.all()]
    return [round((scene.clock.utc() + each) / 60) % 60 for each in left_s]


@pytest.mark.parametrize("end", [5, 20])
def test_a_window_changed_in_the_configuration_has_its_new_end(scenes: Any, tmp_path: Path, end: int) -> None:
    """Without a moment in which recovery would act. A window that gets its former end again opens again."""
    settings = [[{"when": f"02:00-02:{each:02}", "container": "cam"}] for each in (10, end)]
    first = scenes(tmp_path, maintenance=settings[0])
    first.clock.jump_utc(1795312860.0 - first.clock.utc())  # 2026-11-22 02:01 UTC
    first.agent.rest(10)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, maintenance=settings[1])
    second.agent.rest(20)
    assert second.changes() == [("cam", True)] * 2
    assert "is over: the configuration has changed it; cam is still on hold" in second.last()
    assert ends(second) == [end]
    second.agent.stop()
    third = scenes(tmp_path, first.clock, maintenance=settings[0])
    third.agent.rest(20)
    assert ends(third) == [10]


def restarted(scene: Scene) -> HoldService:
    """The hold service of the next PHM, with the holds of the scene."""
    agent = scene.agent
    world = HoldInputs(lambda: ArmedStatus(scene.armed, "armed"), lambda key: None, agent.executor.action_on)
    return HoldService(
        agent.settings.recovery,
        agent.settings.containers,
        scene.holds,
        agent.pipeline,
        agent.bus.publish,
        scene.clock,
        world,
    )


@pytest.mark.parametrize(("before", "left"), [(True, ["cam"]), (False, [])])
def test_a_respected_stop_ends_only_on_arming(scene: Scene, before: bool, left: list[str]) -> None:
    """A stop that was respected in flight stays so when PHM is restarted in flight; one from the ground does not."""
    known = RecoveryState(armed=LastArmedState(before, 0.0))
    scene.agent.executor.restore(PersistedState(recovery=known))
    scene.holds.put(Hold("cam", "stop", scene.clock.mono() + 600.0, "an operator"))
    scene.armed = ArmedState.ARMED
    following = restarted(scene)
    following.tick()
    assert [hold["container"] for hold in following.snapshot()] == left


def test_arming_while_phm_restarts_ends_holds_from_the_ground(scene: Scene) -> None:
    """The saved state says armed already, but nothing had ended them. Neither can have begun while armed."""
    scene.agent.executor.restore(PersistedState(recovery=RecoveryState(armed=LastArmedState(True, 0.0))))
    scene.holds.put(Hold("app", OPERATOR, scene.clock.mono() + 600.0, BY))
    scene.holds.put(Hold("cam", WINDOW, scene.clock.mono() + 600.0, "a window"))
    scene.holds.put(Hold("cam", OPERATOR, scene.clock.mono() + 600.0, BY))
    scene.armed = ArmedState.ARMED
    following = restarted(scene)
    following.tick()
    assert [(hold["container"], hold["source"]) for hold in following.snapshot()] == [("cam", OPERATOR)]


def restored_hold(left_s: float, *, boot: str, now: Stamp) -> Hold:
    """A hold with `left_s` left at (utc 1000, mono 500), as read back at another time."""
    holds = HoldRegistry()
    holds.put(Hold("app", "operator", 500.0 + left_s, BY, "why"))
    state = PersistedState(recovery=RecoveryState(holds=holds.kept(500.0)))
    document = json.loads(json.dumps(encode(state, "boot", Stamp(1000.0, 500.0))))
    return decode(document, boot, now, 600.0).recovery.holds[0].hold


@pytest.mark.parametrize("utc", [0.0, 1000.0, 1e9])
def test_the_end_is_unchanged_on_the_same_boot(utc: float) -> None:
    """Whatever the wall clock shows."""
    assert restored_hold(90.0, boot="boot", now=Stamp(utc, 530.0)).until == 590.0


@pytest.mark.parametrize("utc", [0.0, 1000.0, 1e9])
def test_the_remaining_time_counts_after_a_reboot(utc: float) -> None:
    """At most half a minute more, and never less because a clock was wrong."""
    assert restored_hold(80.0, boot="other", now=Stamp(utc, 5.0)).until == 95.0


def test_the_remaining_time_is_written_every_half_minute() -> None:
    """So that reboots cannot extend a hold permanently, and not every check writes to the disk."""
    holds = HoldRegistry()
    holds.put(Hold("app", "operator", 600.0, BY))
    assert holds.kept(0.0) == holds.kept(29.0) != holds.kept(31.0)


@pytest.mark.parametrize("body", [{"left_s": "x"}, {"left_s": 1e300}, {"until_mono": None}, {"target": 5}])
def test_a_damaged_hold_does_not_last_longer(body: dict[str, Any]) -> None:
    """It makes the file invalid, or lasts a day at most."""
    good = {
        "target": "app",
        "source": "operator",
        "until_mono": 600.0,
        "left_s": 60.0,
        "by": "",
        "reason": "",
        "occurrence": "",
    }
    document = encode(PersistedState(), "boot", Stamp(1000.0, 500.0))
    document["holds"] = [{**good, **body}]
    with contextlib.suppress(InvalidState):
        kept = decode(document, "other", Stamp(1000.0, 500.0), 600.0).recovery.holds
        assert all(entry.hold.until <= 500.0 + 86400.0 for entry in kept)


def test_a_signal_that_does_not_end_the_container_is_not_a_stop(tmp_path: Path) -> None:
    """`docker kill -s HUP` makes it reload its configuration; SIGTERM may begin a stop."""
    made = settings(containers=[{"name": "app"}], state_dir=str(tmp_path / "state"), run_dir=str(tmp_path / "run"))
    daemon = build_daemon(made)
    for number, end_s, undecided in (("1", 0.0, frozenset()), ("15", 121.0, frozenset({"app"}))):
        event = DockerEvent("container", "app", "kill", f"signal {number}", daemon.clock.stamp(), end_s=end_s)
        daemon.components.docker_events.apply(event)
        assert daemon.components.holds._stops.undecided() == undecided
    daemon.components.bus.close()
