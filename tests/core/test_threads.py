"""A limit of processes: without a new thread the state is consistent and reported, and recovers when there is room."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm import api, testing
from phm.checking.check_turns import CheckRun, ScheduledCheck
from phm.checking.scheduler import CheckScheduler
from phm.core import threads
from phm.core.bus import Bus
from phm.core.closing import ShutdownSequence
from phm.core.model import Event, Note, Phase, Stamp
from phm.core.settings import ContainerSettings
from phm.core.watchdog import DaemonWatchdog
from phm.facts import CannotTell
from phm.probes.blocking_call import BlockingCallWorker
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.transport.dns import Resolver
from phm.transport.docker import EngineTimeout
from tests.checking.test_scheduler import Scripted
from tests.fakes.until import until
from tests.recovery.test_executor import World, make, worlds  # noqa: F401 - a fixture

LIMIT_S = 60.0


class Full:
    """While `full`, no thread whose name has this prefix can be started, as at a limit of processes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = False
        self.names = "phm-"
        start = threading.Thread.start

        def limited(thread: threading.Thread) -> None:
            if self.full and thread.name.startswith(self.names):
                raise RuntimeError("can't start new thread")
            start(thread)

        monkeypatch.setattr(threading.Thread, "start", limited)

    def room(self) -> None:
        self.full = False
        threads.retry()


@pytest.fixture
def limit(monkeypatch: pytest.MonkeyPatch) -> Iterator[Full]:
    full = Full(monkeypatch)
    yield full
    full.room()


def test_a_thread_that_cannot_be_started_waits_and_is_reported(limit: Full) -> None:
    """`retry` starts it as soon as possible; until then the problem names it and what to do."""
    ran = threading.Event()
    limit.full = True
    assert not threads.start(threading.Thread(target=ran.set, name="phm-x", daemon=True))
    threads.retry()
    assert "phm-x" in threads.problem() and "pids_limit" in threads.problem()
    limit.room()
    assert ran.wait(LIMIT_S)
    assert "phm-x" not in threads.problem()


def test_a_second_start_of_one_thread_is_an_error() -> None:
    """Only a thread that was never started waits: our own mistake is not hidden."""
    thread = threading.Thread(target=lambda: None)
    threads.start(thread)
    thread.join()
    with pytest.raises(RuntimeError):
        threads.start(thread)


def test_events_wait_for_the_thread_of_their_subscriber(limit: Full) -> None:
    """Events from before the thread are not lost, and closing without a thread does not raise."""
    bus, seen = Bus(testing.FakeClock()), list[Event]()
    limit.full = True
    bus.subscribe("late", seen.append)
    event = Note(Stamp(0.0, 0.0), "PHM", "early")
    bus.publish(event)
    limit.room()
    until(lambda: seen == [event], "the event")
    limit.full = True
    bus.subscribe("never", seen.append)
    bus.close(0.1)


def test_checks_without_a_thread_run_later(limit: Full) -> None:
    """Stopping does not raise either."""
    clock, batches = testing.FakeClock(), list[CheckRun]()
    engine = CheckScheduler(
        [ScheduledCheck(Scripted(lambda: api.ok("a"), "a"), 20.0, 5.0)], testing.world(), clock, batches.append
    )
    limit.full = True
    engine.start()
    assert "phm-check-1" in threads.problem()
    limit.room()
    until(lambda: batches, "the result")
    engine.stop(0.1)
    clock.advance(1000)


def test_checks_that_have_no_thread_are_unknown(limit: Full) -> None:
    """Not as they were before, for good. They run when the system has room for their thread."""
    clock, batches, hung = testing.FakeClock(), list[CheckRun](), threading.Event()

    def hang() -> api.Result:
        hung.wait()
        return api.ok("back")

    checks = [Scripted(hang, "hung"), Scripted(lambda: api.ok("b"), "b")]
    engine = CheckScheduler(
        [ScheduledCheck(check, 20.0, 5.0) for check in checks], testing.world(), clock, batches.append
    )
    limit.full, limit.names = True, "phm-check-2"
    engine.start()
    assert "phm-check-2" in threads.problem()
    until(lambda: engine.turns[0].running_since is not None, "the run that hangs")
    clock.advance(4.9)
    engine.report_overdue()
    assert not batches and engine.overdue() == ()
    clock.advance(0.2)
    for _ in range(3):
        engine.report_overdue()
    assert [result.summary for batch in batches for unit, result in batch.units.items() if unit in ("hung", "b")] == [
        "the check exceeded its deadline of 5 s; it is still running",
        "the check has waited 5 s for a thread",
    ]
    assert engine.overdue() == ("hung", "b")
    limit.room()
    engine.report_overdue()
    until(lambda: next(iter(batches[-1].units)) == "b" and not batches[-1].overdue, "the other one")
    assert engine.overdue() == ("hung",)
    hung.set()
    engine.stop(0.1)
    clock.advance(1000)


def test_a_fault_opened_at_the_limit_is_recovered_later(limit: Full, worlds: list[World]) -> None:  # noqa: F811
    """The container's thread is missing when the fault opens; the fault waits for it."""
    world = make(worlds)
    limit.full, limit.names = True, "phm-recover-"
    world.fail()
    until(lambda: "phm-recover-app" in threads.problem(), "the fault to reach recovery")
    limit.room()
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert world.runs == ["restart"]


def test_an_action_without_a_thread_is_not_an_attempt(limit: Full, worlds: list[World]) -> None:  # noqa: F811
    """It does not count against the budget, however often, and leaves no lock behind."""
    world = make(worlds)
    limit.full, limit.names = True, "phm-act-"
    world.fail()
    world.until(lambda: "phm-act-restart-app" in threads.problem())
    began = world.clock.mono()
    world.until(lambda: world.clock.mono() > began + 30.0)
    assert world.phases() == []
    limit.full = False
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert world.phases() == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_a_blocking_call_is_rejected_and_works_again(limit: Full) -> None:
    """No call is assigned to a thread that does not exist."""
    worker = BlockingCallWorker("disk")
    limit.full = True
    for _ in range(2):
        with pytest.raises(CannotTell, match="process limit"):
            worker.call(lambda: 1, 1.0)
    limit.full = False
    assert worker.call(lambda: 1, LIMIT_S) == 1


def test_a_name_is_resolved_again_after_the_limit(limit: Full) -> None:
    """A look-up that could not start is not in progress."""
    resolver = Resolver("127.0.0.1", 80, socket.SOCK_STREAM)
    limit.full = True
    assert resolver.ask().is_set()
    with pytest.raises(OSError, match="no thread can be started"):
        resolver.answer()
    limit.full = False
    assert resolver.ask().wait(LIMIT_S)
    assert resolver.answer()[1] == ("127.0.0.1", 80)


def test_a_watchdog_that_could_not_be_started_is_retried() -> None:
    """`problem` reports it as long as it does not run."""
    guard = DaemonWatchdog(("/nonexistent",))
    guard.start()
    assert guard.problem
    guard.start_again()
    assert guard.problem
    guard._command = ("cat",)
    guard.start_again()
    assert not guard.problem
    guard.close()


def quiet(tmp_path: Path, **more: Any) -> Any:
    return settings(
        state_dir=str(tmp_path / "state"),
        run_dir=str(tmp_path / "run"),
        log={"directory": str(tmp_path / "log")},
        checks={"host": {"enabled": False}},
        **more,
    )


def test_a_daemon_that_starts_at_the_limit_becomes_complete(
    limit: Full, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every thread starts when possible, the companion unit reports what is missing, and the stop is orderly."""
    step = ShutdownSequence.step
    # Where the machine lets the thread of a step wait for a CPU, that step does not hang.
    monkeypatch.setattr(ShutdownSequence, "step", lambda self, name, call, _: step(self, name, call, LIMIT_S))
    monkeypatch.setattr("phm.runtime.daemon.STOP_S", 10 * LIMIT_S)
    limit.full = True
    daemon = build_daemon(quiet(tmp_path))
    daemon.start()
    assert "threads cannot be started" in " ".join(daemon.components.health.document()["problems"])
    limit.full = False
    until(lambda: daemon.supervise() and daemon.pipeline.complete, "a first report")
    until(lambda: daemon.supervise() and not threads.problem(), "every thread")
    assert daemon.stop() == ()


def test_the_main_loop_does_not_wait_for_room_behind_the_checks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their threads never end, and without the loop PHM would end itself, after each start."""
    started: list[str] = []
    start = threading.Thread.start

    def limited(thread: threading.Thread) -> None:
        if thread.name.startswith(("phm-check-", "phm-main-loop")):
            if len(started) == 2:
                raise RuntimeError("can't start new thread")
            started.append(thread.name)
        start(thread)

    daemon = build_daemon(quiet(tmp_path))
    monkeypatch.setattr(threading.Thread, "start", limited)
    daemon.start()
    assert sorted(started) == ["phm-check-1", "phm-main-loop"]
    until(lambda: daemon.supervise() and daemon.pipeline.complete, "a first report")
    monkeypatch.undo()
    threads.retry()
    daemon.stop()


def test_ros_is_started_whatever_the_result_of_joining_a_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An unexpected response of the engine is logged, and the ROS child is started nevertheless."""
    app = {"name": "app", "networks": ["n"]}
    daemon = build_daemon(quiet(tmp_path, containers=[app]))
    started, notes = threading.Event(), list[str]()

    def odd(target: object, context: object) -> str:
        raise AttributeError("'list' object has no attribute 'get'")

    monkeypatch.setattr("phm.runtime.network_join.join_networks", odd)
    monkeypatch.setattr(type(daemon.components.probes), "start_ros", lambda probes: started.set())
    monkeypatch.setattr(daemon.pipeline, "note", lambda kind, text: notes.append(text))
    thread = threading.Thread(target=daemon._join_networks)
    thread.start()
    thread.join(LIMIT_S)
    assert started.is_set()
    assert any("could not join the networks of app: AttributeError" in text for text in notes)
    daemon.stop()


def test_ros_does_not_wait_for_a_hung_engine_for_each_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is started after the first call without an answer. The networks are joined after that, if the engine answers again."""
    daemon = build_daemon(quiet(tmp_path, containers=[{"name": f"app{n}", "networks": ["n"]} for n in range(3)]))
    did: list[str] = []

    def hang(container: ContainerSettings, context: object) -> str:
        did.append(f"join {container.key}")
        raise EngineTimeout("no answer within 5 s")

    def join(container: ContainerSettings, context: object) -> str:
        if did[-1] == "start ROS":
            return hang(container, context)
        did.append(f"join {container.key} again")
        return ""

    monkeypatch.setattr("phm.runtime.network_join.join_networks", hang)
    monkeypatch.setattr("phm.runtime.network_join.rejoin_networks", join, raising=False)
    monkeypatch.setattr(type(daemon.components.probes), "start_ros", lambda probes: did.append("start ROS"))
    daemon._join_networks()
    assert did == ["join app0", "start ROS", "join app0", "join app0 again", "join app1 again", "join app2 again"]
    daemon.stop()
