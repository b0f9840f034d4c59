"""The process of `phm run`: one PHM per directory, and signals."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from phm.core.instance_lock import NAME, AlreadyRunning, InstanceLock
from phm.core.signals import Signals
from phm.wire import control
from tests.fakes.until import until
from tests.runtime.running import LIMIT_S, PATIENT, ROOT, RUN, Running

# While the main thread waits for an event, a SIGTERM arrives when it holds the event's lock, as can happen by chance.
UNLUCKY = """
import os, signal, threading
wait = threading.Event.wait
def unlucky(event, timeout=None):
    if timeout is not None and threading.current_thread() is threading.main_thread():
        with event._cond:  # type: ignore[attr-defined]
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(1000): pass
    return wait(event, timeout)
threading.Event.wait = unlucky
"""

# The daemon of a new configuration cannot be started, after that of the present one has ended.
HALFWAY = """
from phm.runtime.daemon import Daemon
begin, begun = Daemon._start_recovery, []
def fail(daemon):
    begun.append(daemon)
    if len(begun) > 1:
        raise MemoryError("no thread")
    begin(daemon)
Daemon._start_recovery = fail
"""

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
    script.write_text(PATIENT + UNLUCKY + RUN)
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
    script.write_text(PATIENT + HALFWAY + RUN)
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
    script.write_text(UNLUCKY + RUN)
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
