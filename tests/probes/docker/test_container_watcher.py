"""The container watcher: events of configured containers, events that the stream lost, reconnecting."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.probes import container_watcher
from phm.probes.container_watcher import ContainerWatcher
from phm.probes.docker_event import DockerEvent
from phm.probes.event_decoder import ENDLESS_STOP_S, KILL_S, STOP_S
from phm.testing import settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import DropStream, Hang, Status
from tests.fakes.until import until
from tests.probes.docker.conftest import HUNG_S, LONG_S


class EventList(list[DockerEvent]):
    """The events of a watcher, also as short texts."""

    def texts(self) -> list[str]:
        return [f"{event.key} {event.action} {event.detail}".strip() for event in list(self)]


CONFIRM_S = "phm.probes.container_watcher.CONFIRM_S"
CONFIRMED_S = container_watcher.CONFIRM_S


@pytest.fixture
def watch(
    fake: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., tuple[ContainerWatcher, EventList]]]:
    """Start a watcher on the fake engine, and wait until it is connected and has listed the containers once.

    On a busy machine the thread that reads the events may be late, and the comparison would rightly take them for lost. It waits
    long for them here; where an event is lost, a test sets the usual time.
    """
    started: list[tuple[ContainerWatcher, DockerEngine]] = []
    monkeypatch.setattr(CONFIRM_S, 30.0)

    def start(*containers: dict[str, Any], compare: float = 60.0) -> tuple[ContainerWatcher, EventList]:
        events = EventList()
        engine = DockerEngine(fake.url, timeout_s=LONG_S)
        chosen = settings(containers=list(containers), docker={"compare": compare})
        made = ContainerWatcher(engine, chosen.containers, chosen.docker, SystemClock(), events.append)
        started.append((made, engine))
        made.start()
        assert fake.wait(lambda server: server.streams == 1)
        return made, events

    yield start
    for made, engine in started:
        made.stop()
        engine.close()


def test_events_of_a_configured_container_are_published(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """Death with its exit code, health with its status; both trigger the checks of the container."""
    fake.containers["app"] = container("app", health="healthy")
    _, events = watch({"name": "app", "alias": "ros"})
    fake.set("app", health="unhealthy")
    fake.set("app", status="exited", exit_code=137)
    until(lambda: len(events) == 2, "two events")
    assert events.texts() == ["ros health_status unhealthy", "ros die exit code 137"]
    assert events[0].subjects == {"container:ros"}
    assert not events[0].lost


def test_other_containers_and_exec_events_are_ignored(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """Events of a container that is not configured, and runs of a healthcheck, trigger nothing."""
    fake.containers["app"], fake.containers["db"] = container("app"), container("db")
    _, events = watch({"name": "app"})
    fake.set("db", status="exited")
    fake.emit_for("app", "exec_start: sh -c true")
    fake.emit_for("app", "exec_die")
    fake.emit("network", "connect", "n", name="elsewhere", container="someone")
    fake.set("app", status="paused")
    until(lambda: events, "the event of the configured one")
    assert events.texts() == ["app pause"]


def test_a_start_or_end_of_an_unconfigured_container_is_reported_without_an_event(fake: FakeEngine) -> None:
    """Only that something happened: PHM publishes no events of containers that it does not know."""
    fake.containers["db"] = container("db")
    events, happened = EventList(), threading.Event()
    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    chosen = settings()
    made = ContainerWatcher(
        engine, chosen.containers, chosen.docker, SystemClock(), events.append, on_other=happened.set
    )
    made.start()
    assert fake.wait(lambda server: server.streams == 1)
    fake.emit_for("db", "kill", signal="1")
    for action in ("start", "die"):
        assert not happened.is_set()
        fake.emit_for("db", action)
        assert happened.wait(60.0)
        happened.clear()
    made.stop()
    engine.close()
    assert not events


def test_a_renamed_container_is_still_known(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """The configured name is gone: its check must run."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"})
    until(made.healthy, "the first comparison")
    entry = fake.containers["app"]
    entry["Name"] = "/app_old"
    fake.emit("container", "rename", entry["Id"], name="app_old", oldName="/app")
    until(lambda: events, "the rename")
    assert events.texts() == ["app rename"]


@pytest.mark.parametrize("entry", [{"name": "app"}, {"label": "role=app"}])
def test_the_death_of_a_replaced_container_is_ignored(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]], entry: dict[str, Any]
) -> None:
    """Renamed, a copy started in its place, then removed: the running copy is unaffected."""
    fake.containers["app"] = container("app", labels={"role": "app"})
    made, events = watch(entry)
    until(made.healthy, "the first comparison")
    old = str(fake.containers["app"]["Id"])
    labels = {"role": "app"}
    fake.emit("container", "rename", old, name="app_old", oldName="/app", **labels)
    fake.emit("container", "create", "copy", name="app", **labels)
    fake.emit("container", "start", "copy", name="app", **labels)
    for action in ("kill", "die", "stop", "destroy"):
        fake.emit("container", action, old, name="app_old", signal="9", exitCode="137", **labels)
    fake.emit("container", "die", "copy", name="app", exitCode="1", **labels)
    until(lambda: len(events) >= 4, "the events of the copy")
    assert [event.action for event in events] == ["rename", "create", "start", "die"]
    assert [event.id for event in events] == [old, "copy", "copy", "copy"]


def test_a_container_is_known_by_its_label(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """Events have labels, so a container that Compose recreated is known immediately."""
    _, events = watch({"label": "role=app"})
    fake.containers["swarm-app-1"] = container("swarm-app-1", status="created", labels={"role": "app"})
    fake.set("swarm-app-1", status="running")
    until(lambda: "app start" in events.texts(), "the start")


def test_network_events_trigger_the_network_checks(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """Events of connecting and disconnecting name the network and the container."""
    fake.containers["app"] = container("app", networks=["swarm"])
    made, events = watch({"name": "app", "networks": ["swarm"]})
    until(made.healthy, "the first comparison")
    helper = DockerEngine(fake.url)
    helper.disconnect("swarm", "app", force=True)
    helper.connect("swarm", "app")
    until(lambda: len(events) == 2, "two events")
    assert [(event.kind, event.key, event.action, event.container) for event in events] == [
        ("network", "swarm", "disconnect", "app"),
        ("network", "swarm", "connect", "app"),
    ]
    assert events[0].subjects == {"network"}


def test_a_recreated_network_triggers_the_network_checks(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """Waiting units continue immediately; networks that are not configured trigger nothing."""
    made, events = watch({"name": "app", "networks": ["swarm"]})
    until(made.healthy, "the first comparison")
    for name in ("other", "swarm"):
        fake.emit("network", "destroy", f"id-of-{name}", name=name, type="bridge")
        fake.emit("network", "create", f"new-{name}", name=name, type="bridge")
    until(lambda: len(events) == 2, "two events")
    assert [(event.key, event.action, event.subjects) for event in events] == [
        ("swarm", "destroy", {"network"}),
        ("swarm", "create", {"network"}),
    ]


def test_a_duplicate_disconnect_of_the_engine_is_published_once(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """The duplicate is dropped; after a connection, for another container, or at a later time it is a new disconnect."""
    fake.containers["app"], fake.containers["two"] = container("app"), container("two")
    made, events = watch({"name": "app", "networks": ["swarm"]}, {"name": "two", "networks": ["swarm"]})
    until(made.healthy, "the first comparison")
    ids = {name: fake.containers[name]["Id"] for name in ("app", "two")}

    def emit(action: str, name: str) -> None:
        fake.emit("network", action, "n1", name="swarm", container=ids[name])

    for action, name in (
        ("disconnect", "app"),
        ("disconnect", "two"),
        ("disconnect", "app"),
        ("connect", "app"),
        ("disconnect", "app"),
        ("disconnect", "app"),
    ):
        emit(action, name)
    fake.set("app", status="paused")
    until(lambda: events and events[-1].action == "pause", "the last event")
    assert [(event.action, event.container) for event in events[:-1]] == [
        ("disconnect", "app"),
        ("disconnect", "two"),
        ("connect", "app"),
        ("disconnect", "app"),
    ]


def test_a_disconnect_seconds_after_another_is_published(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """The engine's own clock decides: the missed event in between is a connection, and both disconnects were real."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app", "networks": ["swarm"]})
    until(made.healthy, "the first comparison")
    app = fake.containers["app"]["Id"]
    fake.emit("network", "disconnect", "n1", name="swarm", container=app)
    fake.clock_ahead_s += 2.0
    fake.emit("network", "disconnect", "n1", name="swarm", container=app)
    until(lambda: len(events) == 2, "both")


def test_lost_events_are_found_by_comparison(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A change without an event is published within a comparison period, marked as lost."""
    monkeypatch.setattr(CONFIRM_S, CONFIRMED_S)
    fake.containers["app"] = container("app", health="healthy", networks=["swarm"])
    made, events = watch({"name": "app"}, compare=0.5)
    until(made.healthy, "the first comparison")
    fake.set("app", silently=True, status="exited", exit_code=139)
    fake.containers["app"]["NetworkSettings"]["Networks"].clear()
    until(lambda: len(events) >= 2, "the lost events")
    assert events.texts() == ["app die exit code 139", "swarm disconnect"]
    assert all(event.lost for event in events)


def test_published_events_are_not_repeated_by_the_comparison(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """The comparison knows the resulting state of the events."""
    fake.containers["app"] = container("app", health="healthy")
    made, events = watch({"name": "app"}, compare=0.5)
    until(made.healthy, "the first comparison")
    fake.set("app", status="paused")
    until(lambda: events, "the pause")
    comparisons = list(fake.calls).count("GET /containers/app/json")
    until(lambda: list(fake.calls).count("GET /containers/app/json") >= comparisons + 3, "three more comparisons")
    assert events.texts() == ["app pause"]


def test_a_broken_stream_is_reopened_and_missed_events_are_published(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a reconnect the containers are compared immediately, regardless of the period."""
    monkeypatch.setattr(CONFIRM_S, CONFIRMED_S)
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"}, compare=60.0)
    until(made.healthy, "the first comparison")
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    fake.set("app", silently=True, status="exited", exit_code=1)
    fake.fault = None
    until(lambda: events, "the lost death")
    assert events.texts() == ["app die exit code 1"]
    fake.set("app", status="running")
    until(lambda: len(events) == 2, "the next event over the new stream")


def test_events_during_an_interruption_are_replayed_by_the_engine(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """The stream resumes where it broke off, without duplicates or gaps."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"}, compare=60.0)
    until(made.healthy, "the first comparison")
    fake.set("app", status="paused")
    until(lambda: events, "an event with a time")
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    fake.set("app", status="running")
    fake.set("app", status="exited", exit_code=1)
    fake.fault = None
    until(lambda: "app die exit code 1" in events.texts(), "the missed events")
    assert events.texts() == ["app pause", "app start", "app die exit code 1"]


@pytest.mark.parametrize("fault", [Status(500), Hang()])
def test_a_failing_engine_is_retried_and_makes_the_watcher_unhealthy(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]], fault: Any
) -> None:
    """While the engine fails the watcher is unhealthy; afterwards it recovers by itself."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"}, compare=0.5)
    until(made.healthy, "the first comparison")
    made._engine.timeout_s = HUNG_S
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    fake.fault = fault
    until(lambda: not made.healthy(), "the failure to be reported")
    fake.fault = None
    until(made.healthy, "the recovery")
    fake.set("app", status="exited")
    until(lambda: events, "an event")


def test_a_listener_that_raises_does_not_end_the_watcher(fake: FakeEngine) -> None:
    """A defect in a listener costs only its own event."""
    fake.containers["app"] = container("app")
    events: list[str] = []

    def listen(event: DockerEvent) -> None:
        events.append(event.action)
        raise RuntimeError("injected")

    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    made = ContainerWatcher(
        engine, settings(containers=[{"name": "app"}]).containers, settings().docker, SystemClock(), listen
    )
    made.start()
    assert fake.wait(lambda server: server.streams == 1)
    fake.set("app", status="paused")
    fake.set("app", status="running")
    until(lambda: events == ["pause", "start"], "both events")
    made.stop()
    engine.close()


def test_stop_ends_both_threads(fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]) -> None:
    """Nothing keeps running after `stop`, although the stream was silent."""
    made, _ = watch({"name": "app"})
    made.stop()
    assert {thread.name for thread in made._threads} == {"phm-docker-events", "phm-docker-compare"}
    assert not any(thread.is_alive() for thread in made._threads)


def test_a_start_begins_a_generation_once(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`docker restart` emits `start` and `restart` for one generation; the same for a restart whose event was lost."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"}, compare=0.5)
    until(made.healthy, "the first comparison")
    fake.set("app", status="exited")
    fake.set("app", status="running")
    fake.emit_for("app", "restart")
    until(lambda: len(events) == 3, "three events")
    comparisons = list(fake.calls).count("GET /containers/app/json")
    until(
        lambda: list(fake.calls).count("GET /containers/app/json") >= comparisons + 2,
        "a comparison that knows this generation",
    )
    monkeypatch.setattr(CONFIRM_S, CONFIRMED_S)
    fake.containers["app"]["State"]["StartedAt"] = "2030-01-01T00:00:00.0Z"
    until(lambda: len(events) == 4, "the lost restart")
    assert [(event.action, event.lost, event.starts) for event in events] == [
        ("die", False, False),
        ("start", False, True),
        ("restart", False, False),
        ("restart", True, True),
    ]


def test_a_broken_or_reopened_stream_is_published(fake: FakeEngine) -> None:
    """Usually the engine stopped or started: its check runs immediately, and again when it cannot connect."""
    turns: list[int] = []
    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    made = ContainerWatcher(
        engine,
        settings(containers=[{"name": "app"}]).containers,
        settings().docker,
        SystemClock(),
        lambda event: None,
        lambda: turns.append(1),
    )
    made.start()
    until(lambda: turns, "the opened stream")
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    fake.fault = Status(500)
    until(lambda: len(turns) >= 3, "the broken stream and a failed attempt")
    fake.fault = None
    before = len(turns)
    assert fake.wait(lambda server: server.streams == 1)
    until(lambda: len(turns) > before, "the reopened stream")
    made.stop()
    engine.close()


@pytest.mark.parametrize(
    ("config", "signal", "end_s"),
    [
        ({}, "15", STOP_S),
        ({"StopSignal": "SIGINT"}, "2", STOP_S),
        ({"StopSignal": "INT", "StopTimeout": 300}, "2", 300 + KILL_S),
        ({"StopSignal": "SIGRTMIN+3", "StopTimeout": -1}, "37", ENDLESS_STOP_S),
        ({"StopSignal": "SIGINT"}, "15", KILL_S),
        ({}, "9", KILL_S),
        ({}, "1", 0.0),
    ],
)
def test_a_kill_has_the_time_that_the_container_may_take_to_stop(
    fake: FakeEngine,
    watch: Callable[..., tuple[ContainerWatcher, EventList]],
    config: dict[str, Any],
    signal: str,
    end_s: float,
) -> None:
    """From the container's stop signal and timeout; SIGKILL ends that time, and other signals need not stop it."""
    fake.containers["app"] = container("app")
    fake.containers["app"]["Config"].update(config)
    made, events = watch({"name": "app"})
    until(lambda: made.healthy(), "the first comparison")
    fake.emit_for("app", "kill", signal=signal)
    until(lambda: events, "the event")
    assert events[0].harmless is (end_s == 0)
    assert (events[0].detail, events[0].end_s) == (f"signal {signal}", end_s)


def test_events_are_replayed_even_if_none_arrived_before_the_stream_broke(
    fake: FakeEngine, watch: Callable[..., tuple[ContainerWatcher, EventList]]
) -> None:
    """From the moment when the stream was first open."""
    fake.containers["app"] = container("app")
    made, events = watch({"name": "app"}, compare=60.0)
    until(made.healthy, "the first comparison")
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    fake.set("app", status="paused")
    fake.set("app", status="running")
    fake.fault = None
    until(lambda: len(events) == 2, "the missed events")
    assert events.texts() == ["app pause", "app start"]


@pytest.mark.parametrize(("missed_s", "complete"), [(60.0, True), (0.0, False)])
def test_the_stream_reports_since_when_it_is_complete(
    fake: FakeEngine,
    watch: Callable[..., tuple[ContainerWatcher, EventList]],
    monkeypatch: pytest.MonkeyPatch,
    missed_s: float,
    complete: bool,
) -> None:
    """A short interruption is replayed; after a long one, and at the start, events may be missing."""
    monkeypatch.setattr("phm.probes.container_watcher.MISSED_S", missed_s)
    fake.containers["app"] = container("app")
    made, _ = watch({"name": "app"})
    until(lambda: made.fact.open, "the stream")
    before = made.fact
    assert before.complete_since == before.since
    fake.fault = DropStream()
    until(lambda: not made.fact.open, "the interruption")
    assert made.fact.since >= before.since
    fake.fault = None
    until(lambda: made.fact.open, "the stream again")
    assert (made.fact.complete_since == before.complete_since) is complete
