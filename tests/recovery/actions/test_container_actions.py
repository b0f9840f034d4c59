"""The actions on a fake engine: their effect, their refusals, and that repeating them is harmless."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from phm.core.model import Evidence
from phm.facts import CannotTell, NotPermitted
from phm.probes.docker import Docker
from phm.probes.ros.unnamed_participants import UNNAMED_S
from phm.recovery.actions.reconnect import Reconnect
from phm.recovery.actions.relaunch import Relaunch
from phm.recovery.actions.restart import MOST_STOP_S, Restart
from phm.recovery.actions.restore_file import RestoreFile
from phm.recovery.actions.start import Start
from phm.recovery.actions.unpause import Unpause
from phm.recovery.attempt import GuardedEngine
from phm.recovery.base import Action, ActionFailed, NotNeeded
from phm.testing import FakeClock
from phm.transport.docker import DockerEngine, EngineBroken, EngineTimeout
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status
from tests.recovery.action_bench import Bench, bench, fault

PATH = "/ws/src/critical_file"
GOOD = b"#!/bin/sh\nexit 0\n"
SUM = hashlib.sha256(GOOD).hexdigest()
RUN = ["ros2", "run", "package", "one"]
EXITED = fault("container/app", "exited")


def acted_on(fake: FakeEngine, *verbs: str) -> list[str]:
    """Containers acted on, in order."""
    ids = {entry["Id"]: name for name, entry in fake.containers.items()}
    calls = [call.split("/") for call in fake.calls if call.startswith("POST /containers/")]
    return [ids.get(parts[2], parts[2]) for parts in calls if parts[-1] in verbs]


# ---------------------------------------------------------------- dependents


def stack(fake: FakeEngine, ask: DockerEngine, **more: Any) -> Bench:
    """`app`, whose network `side` shares by id; `late` starts after `side`, `apart` is independent."""
    for name in ("late", "apart", "side", "app"):
        fake.containers[name] = container(name)
    fake.containers["side"]["HostConfig"]["NetworkMode"] = f"container:{fake.containers['app']['Id']}"
    late = {"name": "late", "recover": True, "after": ["side", "app"], **more.pop("late", {})}
    side = {"name": "side", "recover": True, **more.pop("side", {})}
    return bench(ask, containers=[late, {"name": "apart", "recover": True}, side, {"name": "app", "recover": True}])


def test_dependents_are_restarted_after_their_container_in_order(fake: FakeEngine, ask: DockerEngine) -> None:
    """Containers in its network namespace, then containers that name one of them in `after`; no others."""
    made = stack(fake, ask)
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "side", "late"]
    assert words == "restarted app; restarted side, which depends on it; restarted late, which depends on it"
    assert made.held == [("side", "container/app"), ("late", "container/app")]


def test_a_namespace_shared_by_name_counts_too(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine keeps the name that the user wrote."""
    made = stack(fake, ask)
    fake.containers["side"]["HostConfig"]["NetworkMode"] = "container:app"
    fake.set("app", status="exited", exit_code=1)
    made.run(Start, "app", EXITED)
    assert acted_on(fake, "start", "restart") == ["app", "side", "late"]


@pytest.mark.parametrize("mode", ["NetworkMode", "PidMode", "IpcMode"])
def test_a_restart_waits_for_the_owner_of_a_namespace(fake: FakeEngine, ask: DockerEngine, mode: str) -> None:
    """The engine would stop the container and then refuse to start it. One that is down anyway loses nothing."""
    made = stack(fake, ask)
    owner = fake.containers["app"]
    fake.containers["side"]["HostConfig"].update({"NetworkMode": "bridge", mode: f"container:{owner['Id']}"})

    def waits() -> str:
        return Restart().waits_for(made.target("side"), EXITED, made.context())

    assert waits() == ""
    fake.set("app", status="exited", exit_code=1)
    assert waits() == "app, whose namespace it uses, does not run: PHM waits until it does"
    del fake.containers["app"]
    assert waits() == f"{owner['Id'][:12]}, whose namespace it uses, was removed, and a restart would leave it stopped"
    fake.set("side", status="exited", exit_code=1)
    assert waits() == ""


def test_an_unnecessary_start_restarts_no_dependent(fake: FakeEngine, ask: DockerEngine) -> None:
    """Started twice: the second time dependents are not touched."""
    made = stack(fake, ask)
    assert made.run(Start, "app", EXITED) == "app is already running"
    assert acted_on(fake, "start", "restart") == []


def test_a_container_given_up_is_started_without_its_dependents(fake: FakeEngine, ask: DockerEngine) -> None:
    """It is started repeatedly while it is down; running dependents must not be restarted each time."""
    made = stack(fake, ask)
    fake.containers["app"]["State"].update(Status="exited", Running=False)
    alone = replace(made.context(), alone=True)
    assert Start().run(made.target("app"), EXITED, alone) == "started app"
    assert acted_on(fake, "start", "restart") == ["app"]


def test_a_dependent_that_has_not_opted_in_is_named_and_left_alone(fake: FakeEngine, ask: DockerEngine) -> None:
    """Opt-in also applies to consequences."""
    words = stack(fake, ask, side={"recover": False}).run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "late"]
    assert "side depends on it and has not opted in" in words


def test_a_flight_critical_dependent_is_left_alone_while_armed(fake: FakeEngine, ask: DockerEngine) -> None:
    """A container that may not be restarted for its own fault is not restarted for another's; a start takes nothing
    down.
    """
    made = stack(fake, ask, late={"flight_critical": True})
    made.armed = True
    fake.set("app", status="exited", exit_code=1)
    words = made.run(Start, "app", EXITED)
    assert acted_on(fake, "start", "restart") == ["app"]
    assert "late depends on it: restart of late was not done: flight-critical" in words
    assert "side depends on it: restart of side was not done: it would take down late" in words


def test_a_dependent_that_cannot_be_restarted_is_reported(fake: FakeEngine, ask: DockerEngine) -> None:
    """The target is still recovered, and the other dependents follow."""
    made = stack(fake, ask)
    fake.fault = Status(500, "no", route=f"{fake.containers['side']['Id']}/restart")
    words = made.run(Restart, "app", EXITED)
    assert "side depends on it and could not be restarted" in words
    assert acted_on(fake, "restart")[-1] == "late"


def test_a_dependent_that_was_started_later_is_left_alone(fake: FakeEngine, ask: DockerEngine) -> None:
    """Another container's recovery was faster: one restart is enough. Dependents of a restarted one are always
    restarted.
    """
    made = stack(fake, ask)
    made.when_in_hand = lambda: fake.containers["side"]["State"].update(StartedAt="2026-01-01T00:00:01Z")
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "late"]
    assert "side, which depends on it, was started after it already" in words
    fake.calls.clear()
    made.when_in_hand = lambda: fake.containers["late"]["State"].update(StartedAt="2026-01-01T00:00:01Z")
    made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "side", "late"]


@pytest.mark.parametrize("action", [Start, Restart])
def test_a_dependent_that_was_only_created_is_left_alone(
    fake: FakeEngine, ask: DockerEngine, action: type[Action]
) -> None:
    """`docker compose up` starts it when what it waits for is healthy. A start that failed, an error of the engine, is repeated."""
    made = stack(fake, ask)
    for name in ("late", "side"):
        fake.set(name, status="created")
    fake.containers["side"]["State"]["Error"] = "its network was not there"
    if action is Start:
        fake.set("app", status="exited", exit_code=1)
    words = made.run(action, "app", EXITED)
    assert acted_on(fake, "start", "restart") == ["app", "side"]
    assert "late, which depends on it, has not been started yet" in words


def test_dependents_are_determined_from_an_answer_after_the_action(fake: FakeEngine, ask: DockerEngine) -> None:
    """An answer from before the start, however recent, does not show which containers run after it."""
    made = stack(fake, ask)
    made.probe = Docker(
        ask, made.settings.containers, made.settings.docker, FakeClock()
    )  # no time passes, so every answer stays recent
    fake.set("app", status="exited", exit_code=1)
    for name in ("app", "side"):
        assert made.fact(name) is not None
    words = made.run(Start, "app", EXITED)
    assert words == "started app; restarted side, which depends on it; restarted late, which depends on it"
    assert acted_on(fake, "start", "restart") == ["app", "side", "late"]


@pytest.mark.parametrize("fails", [False, True])
def test_an_action_invalidates_cached_answers(fake: FakeEngine, ask: DockerEngine, *, fails: bool) -> None:
    """Also after a failed action: the engine may still have executed it."""
    made = stack(fake, ask)
    probe = made.probe = Docker(ask, made.settings.containers, made.settings.docker, FakeClock())
    probe.container("app")
    asked = len(fake.calls)
    fake.fault = Status(500, "no", route="/restart") if fails else None
    with contextlib.suppress(EngineBroken):
        ask.restart("app")
    probe.container("app")
    assert len(fake.calls) == asked + 2


def test_a_clock_that_was_set_back_prevents_no_restart_of_a_dependent(fake: FakeEngine, ask: DockerEngine) -> None:
    """Its StartedAt is later than that of the container whose namespace it lost; generations decide, not timestamps."""
    made = stack(fake, ask)
    fake.containers["side"]["State"]["StartedAt"] = "9999-01-01T00:00:00Z"
    made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "side", "late"]


def test_the_armed_state_is_checked_once_the_dependent_is_locked(fake: FakeEngine, ask: DockerEngine) -> None:
    """Locking it may have taken a while, in which the vehicle was armed."""
    made = stack(fake, ask, side={"flight_critical": True})
    made.when_in_hand = lambda: setattr(made, "armed", True)
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "late"]
    assert "side depends on it: restart of side was not done: flight-critical" in words


def test_an_unpaused_container_is_not_restarted_before_its_nodes_can_be_known() -> None:
    """After a long pause their names need a new participant of PHM, and that one the time in which nodes find each other."""
    assert Reconnect.dependents_within_s is not None
    assert Unpause.dependents_within_s >= UNNAMED_S + Reconnect.dependents_within_s


def test_an_external_start_is_not_credited_to_the_action(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before PHM checks, or between that and its call: the engine reports whether this call started the container."""
    made = stack(fake, ask)
    assert isinstance(made.run(Start, "app", EXITED), NotNeeded)
    running = made.fact("app")
    assert running is not None
    monkeypatch.setattr(Bench, "fact", lambda self, key: replace(running, status="exited"))
    said = made.run(Start, "app", EXITED)
    assert isinstance(said, NotNeeded) and "outside PHM" in said
    fake.set("app", status="exited", exit_code=1)
    assert not isinstance(made.run(Start, "app", EXITED), NotNeeded)


@pytest.mark.parametrize(("asked", "given"), [(None, 5), (2, 5), (30, 30), (3600, 120), (-1, 120)])
def test_a_container_gets_its_own_stop_timeout(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch, asked: int | None, given: int
) -> None:
    """`recovery.stop_timeout` is the minimum; the container's own stop timeout applies when longer, up to two minutes."""
    times: list[float] = []
    restart = ask.restart
    monkeypatch.setattr(ask, "restart", lambda ref, time_s: (times.append(time_s), restart(ref, time_s)))
    made = stack(fake, ask)
    for name in ("app", "side"):
        fake.containers[name]["Config"]["StopTimeout"] = asked
    made.run(Restart, "app", EXITED)
    assert times == [given, given, 5]


@pytest.mark.parametrize("action", [Restart, Reconnect])
@pytest.mark.parametrize("stop_timeout", [0, 300])
def test_a_restart_is_not_abandoned_before_the_engine_gives_up(
    ask: DockerEngine, action: type[Action], stop_timeout: int
) -> None:
    """It would count as failed while the container is still being stopped for as long as the configuration allows."""
    made = bench(ask, containers=[{"name": "app", "recover": True}], recovery={"stop_timeout": stop_timeout})
    assert action().limit_s(made.context()) > max(stop_timeout, MOST_STOP_S) + 2 * ask.act_limit_s


def test_an_abandoned_action_may_only_finish_what_it_has_begun(fake: FakeEngine, ask: DockerEngine) -> None:
    """Another attempt may act on the container now; but a network that it has disconnected must not stay so."""
    fake.containers["app"], fake.containers["side"] = container("app"), container("side")
    context = bench(ask, containers=[{"name": "app", "recover": True}, {"name": "side"}]).context()
    engine = cast(GuardedEngine, context.engine)
    engine.stop("app")
    engine.abandoned = True
    with pytest.raises(CannotTell, match="restart of side was not done: the action had taken too long"):
        engine.restart("side")
    engine.start("app")
    assert acted_on(fake, "stop", "start", "restart") == ["app", "app"]


# ---------------------------------------------------------------- relaunch


def ros(fake: FakeEngine, ask: DockerEngine, relaunch: list[str] | None = None, status: str = "running") -> Bench:
    fake.containers["app"] = container("app", status=status)
    nodes = [{"name": "/a/one", "container": "app", "relaunch": RUN if relaunch is None else relaunch}]
    topics = [{"name": "/a/topic", "publishers": ["/a/one"], "rate": 10}]
    return bench(ask, containers=[{"name": "app", "recover": True}], ros={"nodes": nodes, "topics": topics})


def test_relaunch_runs_the_command_inside_the_container(fake: FakeEngine, ask: DockerEngine) -> None:
    """Argument by argument, detached, as the container's own user."""
    ros(fake, ask, ["run", "a b", "$(reboot)"]).run(
        Relaunch, "app", fault("nodes/a/one", "node_missing", node="/a/one")
    )
    (program,) = fake.programs
    assert program["Cmd"] == ["run", "a b", "$(reboot)"]
    assert (program["Started"], program["Detach"], program["User"]) == (True, True, "")


def test_a_repeated_relaunch_starts_one_copy(fake: FakeEngine, ask: DockerEngine) -> None:
    """PHM may be killed between executing and recording it."""
    made = ros(fake, ask)
    made.run(Relaunch, "app", fault("nodes/a/one", "node_missing", node="/a/one"))
    with pytest.raises(ActionFailed, match="a second copy is not started"):
        made.run(Relaunch, "app", fault("nodes/a/one", "node_missing", node="/a/one"))
    made.nodes = {"/a/one": 1}
    assert made.run(Relaunch, "app", fault("nodes/a/one", "node_missing", node="/a/one")) == "/a/one is listed again"
    assert len(fake.programs) == 1


def test_a_dead_node_that_is_still_listed_has_not_returned(fake: FakeEngine, ask: DockerEngine) -> None:
    """It was reported dead while listed, since its lease continues: only an additional entry of its name is the node."""
    made = ros(fake, ask)
    made.nodes = {"/a/one": 1}
    dead = fault("nodes/a/one", "node_missing", Evidence(listed=1), "/a/one")
    assert made.run(Relaunch, "app", dead).startswith("relaunched /a/one")
    made.nodes = {"/a/one": 2}
    assert made.run(Relaunch, "app", dead) == "/a/one is listed again"


@pytest.mark.parametrize("condition", ["topic_silent", "rate_low"])
def test_a_hung_node_is_not_relaunched(fake: FakeEngine, ask: DockerEngine, condition: str) -> None:
    """Two nodes of one name disturb each other: the next step restarts the container."""
    made = ros(fake, ask)
    made.nodes = {"/a/one": 1}
    with pytest.raises(ActionFailed, match="still running"):
        made.run(Relaunch, "app", fault("rates/a/topic", condition, node="/a/one"))
    made.nodes = {}
    made.run(Relaunch, "app", fault("rates/a/topic", condition, node="/a/one"))
    assert len(fake.programs) == 1


def test_relaunch_applies_to_nodes_with_a_command_in_this_container(fake: FakeEngine, ask: DockerEngine) -> None:
    """For a topic, its first publisher; without a command the ladder continues without this step."""
    made = ros(fake, ask)
    app = made.target("app")
    assert Relaunch.applies(app, fault("nodes/a/one", "node_missing", node="/a/one"), made.sections)
    assert Relaunch.applies(app, fault("rates/a/topic", "topic_silent", node="/a/one"), made.sections)
    assert not Relaunch.applies(app, fault("nodes/a/two", "node_missing", node="/a/two"), made.sections)
    other = ros(fake, ask, relaunch=[])
    assert not Relaunch.applies(app, fault("nodes/a/one", "node_missing", node="/a/one"), other.sections)


# ---------------------------------------------------------------- restore


def files(fake: FakeEngine, ask: DockerEngine, content: bytes | None, **wanted: Any) -> Bench:
    """`app` with the given file, created from an image that has the correct one."""
    others = {"/ws/src/other": b""}
    fake.containers["app"] = container("app", files=others | ({PATH: content} if content is not None else {}))
    fake.images["image-of-app"] = {PATH: GOOD}
    entry = {"path": PATH, "restore": "image", **wanted}
    return bench(ask, containers=[{"name": "app", "recover": True, "files": [entry]}])


@pytest.mark.parametrize(
    ("content", "wanted"), [(None, {}), (GOOD, {"executable": True}), (b"bad", {"sha256": SUM.upper()})]
)
@pytest.mark.parametrize("source", ["image", "golden"])
def test_a_file_is_restored(
    fake: FakeEngine, ask: DockerEngine, tmp_path: Path, content: bytes | None, wanted: dict[str, Any], source: str
) -> None:
    """Missing, not executable or altered; from the image or from a path that PHM sees; no container remains."""
    golden = tmp_path / "golden"
    golden.write_bytes(GOOD)
    golden.chmod(0o640)
    made = files(fake, ask, content, restore="image" if source == "image" else str(golden), **wanted)
    made.run(RestoreFile, "app", fault("files/app", "file_missing", Evidence(file=PATH)))
    app = fake.containers["app"]
    assert app["_files"][PATH] == GOOD
    plain = 0o644 if source == "image" else 0o640
    assert app["_modes"][PATH] == (plain | 0o111 if wanted.get("executable") else plain)
    assert list(fake.containers) == ["app"]
    calls = len([call for call in fake.calls if call.startswith(("PUT", "POST"))])
    again = made.run(RestoreFile, "app", fault("files/app", "file_missing"))
    assert "as configured" in again and isinstance(again, NotNeeded)
    assert len([call for call in fake.calls if call.startswith(("PUT", "POST"))]) == calls


@pytest.mark.parametrize("source", ["image", "golden"])
def test_a_bad_copy_is_rejected(fake: FakeEngine, ask: DockerEngine, tmp_path: Path, source: str) -> None:
    """A bad file is not replaced by another bad one."""
    golden = tmp_path / "golden"
    golden.write_bytes(b"worse")
    made = files(fake, ask, b"bad", sha256=SUM, restore="image" if source == "image" else str(golden))
    fake.images["image-of-app"] = {PATH: b"worse"}
    with pytest.raises(ActionFailed, match="not have the configured SHA-256"):
        made.run(RestoreFile, "app", fault("files/app", "file_altered", Evidence(file=PATH)))
    assert fake.containers["app"]["_files"][PATH] == b"bad"
    assert list(fake.containers) == ["app"]


@pytest.mark.parametrize("bad", ["missing", "folder", "big"])
def test_a_reference_copy_must_be_a_regular_file_of_limited_size(
    fake: FakeEngine, ask: DockerEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: str
) -> None:
    """An unreadable file is reported with its path."""
    golden = tmp_path / "golden"
    if bad == "folder":
        golden.mkdir()
    elif bad == "big":
        golden.write_bytes(b"x" * 11)
        monkeypatch.setattr("phm.recovery.actions.restore_file.LIMIT", 10)
    with pytest.raises(ActionFailed, match=str(golden)):
        files(fake, ask, None, restore=str(golden)).run(RestoreFile, "app", fault("files/app", "file_missing"))


@pytest.mark.parametrize("where", ["the file", "its folder", "a folder above"])
def test_a_reference_copy_behind_a_link_is_rejected(
    fake: FakeEngine, ask: DockerEngine, tmp_path: Path, where: str
) -> None:
    """The application may be able to write there: PHM would copy into the container what only PHM may read."""
    secret = tmp_path / "phm" / "keys" / "golden"
    secret.parent.mkdir(parents=True)
    secret.write_bytes(b"the signing key")
    volume = tmp_path / "volume"
    golden = volume / "keys" / "golden"
    if where == "a folder above":
        volume.symlink_to(secret.parent.parent, target_is_directory=True)
    elif where == "its folder":
        volume.mkdir()
        golden.parent.symlink_to(secret.parent, target_is_directory=True)
    else:
        golden.parent.mkdir(parents=True)
        golden.symlink_to(secret)
    assert golden.read_bytes() == b"the signing key"
    with pytest.raises(ActionFailed, match=r"not a regular file|reached through a link"):
        files(fake, ask, None, restore=str(golden)).run(RestoreFile, "app", fault("files/app", "file_missing"))
    assert PATH not in fake.containers["app"]["_files"]


def test_a_directory_in_place_of_the_file_is_not_replaced(fake: FakeEngine, ask: DockerEngine) -> None:
    """PHM deletes nothing unknown."""
    made = files(fake, ask, None)
    fake.containers["app"]["_files"][f"{PATH}/inside"] = b""
    with pytest.raises(ActionFailed, match="not a regular file"):
        made.run(RestoreFile, "app", fault("files/app", "file_missing"))


def test_the_container_of_an_interrupted_restore_is_removed(fake: FakeEngine, ask: DockerEngine) -> None:
    """The temporary container of a killed PHM does not block the next one."""
    made = files(fake, ask, None)
    left = f"phm-restore-{fake.containers['app']['Id'][:12]}"
    fake.containers[left] = container(left, status="created")
    made.run(RestoreFile, "app", fault("files/app", "file_missing"))
    assert list(fake.containers) == ["app"]


def test_a_failure_while_reading_the_image_leaves_no_container(fake: FakeEngine, ask: DockerEngine) -> None:
    """It is always removed, whatever happens in between."""
    made = files(fake, ask, None)
    left = f"phm-restore-{fake.containers['app']['Id'][:12]}"
    fake.fault = Status(500, "no", route=f"{container(left)['Id']}/archive")
    with pytest.raises(EngineBroken):
        made.run(RestoreFile, "app", fault("files/app", "file_missing"))
    assert list(fake.containers) == ["app"]


def test_a_forbidden_restore_is_reported(fake: FakeEngine, ask: DockerEngine) -> None:
    """A socket proxy that does not permit creating containers: report only."""
    made = files(fake, ask, None)
    fake.fault = Status(403, "not on the list", route="/containers/create")
    with pytest.raises(NotPermitted):
        made.run(RestoreFile, "app", fault("files/app", "file_missing"))


def test_restore_applies_to_the_file_at_fault(fake: FakeEngine, ask: DockerEngine) -> None:
    """A restorable file other than the failed one does not help."""
    made = files(fake, ask, None)
    app = made.target("app")
    assert RestoreFile.applies(app, fault("files/app", "file_missing", Evidence(file=PATH)), made.sections)
    assert not RestoreFile.applies(app, fault("files/app", "file_missing", Evidence(file="/other")), made.sections)
    plain = bench(ask, containers=[{"name": "app", "files": [{"path": PATH}]}])
    assert not RestoreFile.applies(
        plain.target("app"), fault("files/app", "file_missing", Evidence(file=PATH)), plain.sections
    )


@pytest.mark.parametrize("call", ["exec", "put", "create", "remove"])
def test_each_engine_call_has_a_deadline(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """An engine that accepts the request and never answers costs the action's time limit and no more."""
    monkeypatch.setattr("phm.transport.docker_session.ACT_MARGIN_S", 0.0)
    fake.containers["app"] = container("app")
    ask.version()
    ask.timeout_s = 0.5
    fake.fault = Hang()
    calls: dict[str, Callable[[], object]] = {
        "exec": lambda: ask.exec_detached("app", ["x"]),
        "put": lambda: ask.put_file("app", "/a", b"", 0o644),
        "create": lambda: ask.create_from_image("i", {}),
        "remove": lambda: ask.remove("app"),
    }
    with pytest.raises(EngineTimeout, match=r"within 0\.5 s"):
        calls[call]()
