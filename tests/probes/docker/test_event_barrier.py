"""Events that the engine has sent are applied before results are evaluated, even if their reader thread is late."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.checking.check_turns import CheckRun
from phm.core.clock import SystemClock
from phm.probes.container_watcher import ContainerWatcher
from phm.probes.docker_event import DockerEvent
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import DropStream
from tests.fakes.measured_clock import measured_clock
from tests.fakes.until import until
from tests.probes.docker.conftest import LONG_S


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine the tests themselves may take longer than PHM waits for a reader that is behind, or for an event."""
    for name in ("BEHIND_S", "CONFIRM_S"):
        monkeypatch.setattr(f"phm.probes.container_watcher.{name}", 10 * LONG_S)


class Late:
    """A listener whose thread is late: it receives each event, and continues when the test releases it."""

    def __init__(self) -> None:
        self.taken: list[DockerEvent] = []
        self.applied: list[DockerEvent] = []
        self.go = threading.Event()

    def __call__(self, event: DockerEvent) -> None:
        self.taken.append(event)
        self.go.wait(2 * LONG_S)
        self.applied.append(event)


@pytest.fixture
def late(fake: FakeEngine) -> Iterator[tuple[ContainerWatcher, Late]]:
    fake.containers["app"] = container("app")
    engine, listener = DockerEngine(fake.url, timeout_s=LONG_S), Late()
    chosen = settings(containers=[{"name": "app"}], docker={"compare": 60.0})
    watch = ContainerWatcher(engine, chosen.containers, chosen.docker, SystemClock(), listener)
    watch.start()
    assert fake.wait(lambda server: server.streams == 1)
    yield watch, listener
    listener.go.set()
    watch.stop()
    engine.close()


def test_an_idle_reader_has_caught_up(fake: FakeEngine, late: tuple[ContainerWatcher, Late]) -> None:
    """If nothing was sent, there is nothing to wait for, however long the stream has been open."""
    watch, _ = late
    until(watch.caught_up, "the open stream")


def test_the_barrier_waits_for_applied_and_unread_events(fake: FakeEngine, late: tuple[ContainerWatcher, Late]) -> None:
    """The first event is in the late listener, the second still on the socket; both are applied after the wait."""
    watch, listener = late
    until(watch.caught_up, "the open stream")
    fake.set("app", status="exited", exit_code=1)
    until(lambda: listener.taken, "the first event")
    fake.set("app", status="running")
    assert not watch.caught_up()
    waited: list[int] = []

    def wait() -> None:
        watch.catch_up()
        waited.append(len(listener.applied))

    waiter = threading.Thread(target=wait, daemon=True)
    waiter.start()
    waiter.join(0.3)
    assert waiter.is_alive()
    listener.go.set()
    until(lambda: waited, "the end of the wait")
    assert waited == [2]


def test_the_barrier_does_not_wait_for_a_closed_stream(fake: FakeEngine, late: tuple[ContainerWatcher, Late]) -> None:
    """A disconnected engine sends nothing that could be applied."""
    watch, _ = late
    until(watch.caught_up, "the open stream")
    fake.fault = DropStream()
    assert fake.wait(lambda server: server.streams == 0)
    until(watch.caught_up, "the end of the stream")


@pytest.fixture
def daemon(fake: FakeEngine, tmp_path: Path) -> Iterator[Daemon]:
    fake.containers["app"] = container("app")
    made = settings(
        state_dir=str(tmp_path / "state"),
        run_dir=str(tmp_path / "run"),
        log={"directory": str(tmp_path / "log")},
        checks={"host": {"enabled": False}},
        containers=[{"name": "app", "healthcheck": "ignore"}],
        docker={"socket": fake.url, "timeout": LONG_S},
        ros={"nodes": [], "topics": []},
        recovery={"mode": "off"},
    )
    daemon = build_daemon(made, measured_clock())
    daemon.start()
    yield daemon
    daemon.stop()


def test_results_and_timers_wait_for_earlier_events(
    fake: FakeEngine, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While an event is not applied, no result is evaluated and no timer publishes anything; the main loop continues."""
    until(lambda: daemon.pipeline.complete and daemon.components.probes.caught_up(), "the first report")
    taken, go, order = threading.Event(), threading.Event(), list[str]()

    def late(*event: str) -> None:
        taken.set()
        go.wait(2 * LONG_S)
        order.append("event")

    def result(units: object, started: float, *more: object, **others: object) -> None:
        if started == run.started:
            order.append("result")

    monkeypatch.setattr(daemon.components.holds, "happened", late)
    fake.set("app", status="exited", exit_code=1)
    assert taken.wait(LONG_S)
    for _ in range(2):  # an iteration in progress when the event came is over after the second
        last = daemon.components.loop.last_iteration
        daemon.wake()
        until(lambda: daemon.components.loop.last_iteration > last, "a main-loop iteration")  # noqa: B023
    monkeypatch.setattr(daemon.pipeline, "observe", result)
    monkeypatch.setattr(daemon.pipeline, "tick", lambda: order.append("time"))
    run = CheckRun(
        dict.fromkeys(["container/app"], daemon.pipeline.states()[0].result), daemon.clock.mono(), 0.0, "test"
    )
    bring = threading.Thread(target=daemon.components.scheduler._sink, args=(run,), daemon=True)
    bring.start()
    bring.join(0.3)
    go.set()
    until(lambda: "time" in order and not bring.is_alive(), "the result and the timer")
    assert order[0] == "event"
