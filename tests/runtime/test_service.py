"""The process of `phm run`: one PHM per directory, signals, and a shutdown that nothing can block."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.closing import ShutdownSequence
from phm.core.instance_lock import NAME, AlreadyRunning, InstanceLock
from phm.core.signals import Signals
from phm.runtime.shutdown_marker import NAME as MARKER
from phm.runtime.wiring import build_daemon
from phm.testing import FakeClock, settings
from phm.wire import control
from tests.fakes.until import until

ROOT = Path(__file__).parents[2]
LIMIT_S = 60.0

# While the main thread waits for an event, a SIGTERM arrives when it holds the event's lock, as can happen by chance.
UNLUCKY = """
import os, signal, sys, threading
wait = threading.Event.wait
def unlucky(event, timeout=None):
    if timeout is not None and threading.current_thread() is threading.main_thread():
        with event._cond:  # type: ignore[attr-defined]
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(1000): pass
    return wait(event, timeout)
threading.Event.wait = unlucky
from phm.cli import main
main(sys.argv[1:])
"""

# The daemon of a new configuration cannot be started, after that of the present one has ended.
HALFWAY = """
import sys
from phm.runtime.daemon import Daemon
begin, begun = Daemon._start_recovery, []
def fail(daemon):
    begun.append(daemon)
    if len(begun) > 1:
        raise MemoryError("no thread")
    begin(daemon)
Daemon._start_recovery = fail
from phm.cli import main
main(sys.argv[1:])
"""


class Running:
    """`phm run` with its own configuration."""

    def __init__(self, folder: Path, *before: str, **more: Any) -> None:
        self.folder = folder
        self.write(**more)
        self.process = self.another(*before)

    def write(self, **more: Any) -> None:
        places = {
            "state_dir": str(self.folder / "state"),
            "run_dir": str(self.folder / "run"),
            "log": {"directory": str(self.folder / "log")},
        }
        (self.folder / "phm.yaml").write_text(
            json.dumps({"agent": {"id": 1}, "checks": {"host": {"enabled": False}}, **places, **more})
        )

    def another(self, *before: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *(before or ("-m", "phm.cli")), "run", "-c", str(self.folder / "phm.yaml")],
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks"))), "PHM_WATCHDOG": "off"},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    @property
    def marker(self) -> Path:
        return self.folder / "state" / MARKER

    def ready(self) -> None:
        until(lambda: (self.folder / "run" / control.NAME).exists() and self.marker.exists(), "the daemon")


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    made: list[Running] = []

    def begin(*before: str, **more: Any) -> Running:
        made.append(Running(tmp_path, *before, **more))
        return made[-1]

    yield begin
    for running in made:
        if running.process.poll() is None:
            running.process.kill()
        running.process.communicate()


# ---------------------------------------------------------------- one PHM per directory


def test_a_second_phm_with_the_same_directories_is_rejected(start: Callable[..., Running]) -> None:
    """Exit code 75 and a message with the directory, the process and what to do; the first continues, and a killed one
    leaves no lock.
    """
    first = start()
    first.ready()
    second = first.another()
    output, errors = second.communicate(timeout=LIMIT_S)
    assert (second.returncode, output) == (75, "")
    assert str(first.folder / "state") in errors
    assert f"process {first.process.pid} on " in errors
    assert "stop it first" in errors
    assert control.ask(str(first.folder / "run"), {"do": "ping"}) == "PHM is running"
    first.process.kill()
    first.process.wait()
    again = Running(first.folder)
    try:
        until(lambda: _answers(first.folder), "the next one")
    finally:
        again.process.terminate()
        again.process.communicate(timeout=LIMIT_S)
    assert again.process.returncode == 0


def _answers(folder: Path) -> bool:
    try:
        return control.ask(str(folder / "run"), {"do": "ping"}) == "PHM is running"
    except control.NoAnswer:
        return False


def test_either_shared_directory_rejects_a_second_phm(tmp_path: Path) -> None:
    """State or run directory, by any path; a rejected start locks nothing."""
    first = InstanceLock(str(tmp_path / "state"), str(tmp_path / "run"))
    first.acquire()
    (tmp_path / "link").symlink_to(tmp_path / "run")
    with pytest.raises(AlreadyRunning, match="run: stop it first"):
        InstanceLock(str(tmp_path / "other"), str(tmp_path / "link")).acquire()
    InstanceLock(str(tmp_path / "other")).acquire()
    first.release()
    both = InstanceLock(str(tmp_path), str(tmp_path))
    both.acquire()
    both.release()


def test_a_removed_lock_file_is_created_again(tmp_path: Path) -> None:
    """A lock on a deleted file has no effect: the file at the path counts."""
    first = InstanceLock(str(tmp_path))
    first.acquire()
    (tmp_path / NAME).unlink()
    second = InstanceLock(str(tmp_path))
    second.acquire()
    with pytest.raises(AlreadyRunning):
        InstanceLock(str(tmp_path)).acquire()


def test_a_directory_that_cannot_be_locked_is_a_problem_without_an_exit(tmp_path: Path) -> None:
    """PHM runs on a read-only disk, too, and reports what it cannot detect."""
    (tmp_path / "file").touch()
    lock = InstanceLock(str(tmp_path / "file" / "below"))
    lock.acquire()
    assert "would not be detected" in lock.problem


# ---------------------------------------------------------------- signals


def test_a_signal_that_arrives_while_an_event_is_locked_is_read_later(tmp_path: Path) -> None:
    """The handler takes no lock; signals are read in order, and others keep their handlers."""
    event = threading.Event()
    before = signal.getsignal(signal.SIGUSR1)
    with Signals(signal.SIGUSR1, signal.SIGUSR2) as signals:
        assert signals.wait(0.0) == ()
        with event._cond:  # type: ignore[attr-defined]
            signal.raise_signal(signal.SIGUSR1)
            signal.raise_signal(signal.SIGUSR2)
        assert signals.wait(LIMIT_S) == (signal.SIGUSR1, signal.SIGUSR2)
        assert signals.wait(0.0) == ()
    assert signal.getsignal(signal.SIGUSR1) == before


def test_a_sigterm_at_the_worst_moment_ends_the_daemon(start: Callable[..., Running], tmp_path: Path) -> None:
    """Also while the main thread holds the lock of the event that it waits for."""
    script = tmp_path / "unlucky.py"
    script.write_text(UNLUCKY)
    running = start(str(script))
    running.ready()
    running.process.send_signal(signal.SIGTERM)
    _, errors = running.process.communicate(timeout=LIMIT_S)
    # On a busy machine a part may need longer than PHM waits for it, and PHM says so.
    said = [line for line in errors.splitlines() if "PHM exits although these parts still hang" not in line]
    assert (running.process.returncode, said) == (0, [])


def test_a_reload_that_fails_halfway_ends_phm_at_once(start: Callable[..., Running], tmp_path: Path) -> None:
    """Nothing would be checked until it is noticed as a stall: the exit code has it restarted."""
    script = tmp_path / "halfway.py"
    script.write_text(HALFWAY)
    running = start(str(script))
    running.ready()
    running.write(interval="3s")
    running.process.send_signal(signal.SIGHUP)
    _, errors = running.process.communicate(timeout=LIMIT_S)
    assert running.process.returncode == os.EX_SOFTWARE
    assert "could not start again after a reload" in errors and "no thread" in errors
    assert "the old one remains active" not in errors
    assert running.marker.exists(), "the next start knows that this end was not requested"


def test_a_sigterm_at_the_worst_moment_ends_the_ground_station(tmp_path: Path) -> None:
    """`phm gcs --once` waits for an event in the main thread."""
    script = tmp_path / "unlucky.py"
    script.write_text(UNLUCKY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    done = subprocess.run(
        [sys.executable, str(script), "gcs", f"udpin:127.0.0.1:{port}", "--once", "--for", "600"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=LIMIT_S,
        capture_output=True,
        check=False,
    )
    assert done.returncode in (1, 130)


# ---------------------------------------------------------------- shutdown


@pytest.fixture
def hung_engine(tmp_path: Path) -> Iterator[str]:
    """A Docker Engine that accepts every call and never answers."""
    path = str(tmp_path / "engine.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(200)
        yield f"unix://{path}"


def test_a_hung_engine_does_not_delay_the_shutdown(start: Callable[..., Running], hung_engine: str) -> None:
    """Calls in progress are aborted; the next start finds an orderly shutdown."""
    running = start(docker={"socket": hung_engine, "timeout": "60s"}, containers=[{"name": "app", "networks": ["n"]}])
    running.ready()
    running.process.terminate()
    running.process.communicate(timeout=45)  # the engine's own deadline would come after 60 s
    assert running.process.returncode == 0
    assert not running.marker.exists()


def test_an_intended_shutdown_is_marked_before_anything_can_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that hangs during the shutdown is named, uses only its own time limit, and does not count as a crash at
    the next start.
    """
    step = ShutdownSequence.step

    def lengthened(closing: ShutdownSequence, name: str, call: Callable[[], object], limit_s: float) -> None:
        """On a busy machine a step that does not hang may take longer than its limit."""
        step(closing, name, call, limit_s if name == "state" else LIMIT_S)

    monkeypatch.setattr(ShutdownSequence, "step", lengthened)
    monkeypatch.setattr("phm.runtime.daemon.STOP_S", 20 * LIMIT_S)
    daemon = build_daemon(
        settings(
            state_dir=str(tmp_path / "state"),
            run_dir=str(tmp_path / "run"),
            log={"directory": str(tmp_path / "log")},
            checks={"host": {"enabled": False}},
        )
    )
    daemon.start()
    released, marked = threading.Event(), list[bool]()

    def hang() -> None:
        marked.append((tmp_path / "state" / MARKER).exists())
        released.wait()

    daemon.components.memory.close = hang  # type: ignore[method-assign]
    assert daemon.stop() == ("state",)
    until(lambda: marked, "the step to begin")
    assert marked == [False]
    released.set()


def test_hanging_steps_share_one_budget() -> None:
    """Each has its own limit, all together the budget; later steps still run, and an exception does not end the
    shutdown.
    """
    clock, never, ran = FakeClock(), threading.Event(), list[str]()
    closing = ShutdownSequence(clock, 5.0)
    over = threading.Event()

    def tick() -> None:
        while not over.is_set():
            if clock.sleepers:
                clock.advance(0.05)
            time.sleep(0.001)

    ticker = threading.Thread(target=tick, daemon=True)
    ticker.start()
    began = clock.mono()
    for number in range(4):
        closing.step(f"h{number}", never.wait, 2.0)
    closing.step("raises", lambda: 1 / 0, 2.0)
    closing.step("last", lambda: ran.append("last"), 2.0)
    over.set()
    ticker.join()
    assert clock.mono() - began <= 5.0 + 6 * 0.15
    assert [name for name in closing.hung if name.startswith("h")] == ["h0", "h1", "h2", "h3"]
    until(lambda: ran == ["last"], "the last step")
    never.set()


def test_a_finished_step_is_not_waited_for() -> None:
    """No step takes longer than its work."""
    closing = ShutdownSequence(SystemClock(), 3600.0)
    closing.step("quick", lambda: None, 3600.0)
    assert closing.hung == []


# ---------------------------------------------------------------- systemd


def test_systemd_is_notified_from_start_to_stop(
    start: Callable[..., Running], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """READY after the start, WATCHDOG while PHM works, RELOADING and READY around a reload, STOPPING at the end."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(LIMIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        running = start()
        assert systemd.recv(4096) == b"READY=1"
        assert systemd.recv(4096) == b"WATCHDOG=1"
        running.process.send_signal(signal.SIGHUP)
        assert _next(systemd).startswith(b"RELOADING=1\nMONOTONIC_USEC=")
        assert _next(systemd) == b"READY=1"
        running.process.terminate()
        assert _next(systemd) == b"STOPPING=1"
        running.process.communicate(timeout=LIMIT_S)
    assert running.process.returncode == 0


def _next(systemd: socket.socket) -> bytes:
    """The next notification that is not the watchdog's."""
    while True:
        received = systemd.recv(4096)
        if received != b"WATCHDOG=1":
            return received
