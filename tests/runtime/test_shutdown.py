"""A shutdown that nothing can block, and that ends before PHM would be killed."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.closing import ShutdownSequence
from phm.runtime.daemon import STOP_S, Daemon
from phm.runtime.service import END_S, SPARE_S
from phm.runtime.shutdown_marker import NAME as MARKER
from phm.runtime.wiring import build_daemon
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from tests.fakes.until import until
from tests.runtime.running import LIMIT_S, PATIENT, ROOT, RUN, Running

SHORT = PATIENT.replace("600", "1")
# What the main thread waits for does not happen: while the daemon stops, or while a reload ends the present one.
HANGS = {
    "stop": """
import threading
from phm.checking.pipeline import Pipeline
note = Pipeline.note
def hang(pipeline, kind, text):
    if text == "PHM is stopping":
        threading.Event().wait()
    note(pipeline, kind, text)
Pipeline.note = hang
""",
    "reload": """
import pathlib, sys, threading
from phm.runtime.daemon import Daemon
def hang(daemon):
    # Not before the wait has begun: CPython calls no handler in a wait that begins just after the signal.
    threading.Timer(0.5, pathlib.Path(sys.argv[-1]).with_name("reloads").touch).start()
    threading.Event().wait()
Daemon._hand_over = hang
""",
}


class HungEngine:
    """A Docker Engine that accepts every call and never answers."""

    def __init__(self, listener: socket.socket, path: str) -> None:
        self.url, self.calls = f"unix://{path}", list[socket.socket]()
        self._listener = listener
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # the listener is closed
            while True:
                self.calls.append(self._listener.accept()[0])


@pytest.fixture
def hung_engine(tmp_path: Path) -> Iterator[HungEngine]:
    path = str(tmp_path / "engine.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(200)
        made = HungEngine(listener, path)
        yield made
        listener.shutdown(socket.SHUT_RDWR)
    for call in made.calls:
        call.close()


def _daemon(folder: Path, **more: Any) -> Daemon:
    return build_daemon(
        settings(
            state_dir=str(folder / "state"),
            run_dir=str(folder / "run"),
            log={"directory": str(folder / "log")},
            checks={"host": {"enabled": False}},
            **more,
        )
    )


def _states(ground: socket.socket) -> list[int]:
    """The system state of each HEARTBEAT that has arrived."""
    found = []
    with contextlib.suppress(BlockingIOError):
        while frame := ground.recv(512):
            if frame[0] == 0xFD and int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                found.append(frame[10 + 7])
    return found


def test_a_hung_engine_hangs_no_part_of_the_shutdown(
    hung_engine: HungEngine, tmp_path: Path, patient: Callable[..., None]
) -> None:
    """Calls in progress are aborted, the farewell is sent, and the next start finds an orderly end."""
    patient()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.setblocking(False)
        more: dict[str, Any] = {
            # The engine's own deadline comes later than that of any step.
            "docker": {"socket": hung_engine.url, "timeout": "60s"},
            "containers": [{"name": "app", "networks": ["n"], "recover": True}],
            "mavlink": {"endpoints": [{"url": f"udpout:127.0.0.1:{ground.getsockname()[1]}"}]},
        }
        daemon = _daemon(tmp_path, **more)
        daemon.start()
        until(lambda: len(hung_engine.calls) > 1, "calls of the engine")
        until(lambda: _states(ground), "a HEARTBEAT")
        assert daemon.stop() == ()
        assert _states(ground)[-1] == mavlink.MAV_STATE_POWEROFF
    assert not (tmp_path / "state" / MARKER).exists()
    again = _daemon(tmp_path, **more)
    again.start()
    assert not again.components.health.crashed_before
    again.stop()


def test_a_hung_engine_does_not_delay_the_end_of_the_process(
    start: Callable[..., Running], hung_engine: HungEngine
) -> None:
    """Exit code 0, and no part hangs because of the engine."""
    running = start(
        docker={"socket": hung_engine.url, "timeout": "60s"}, containers=[{"name": "app", "networks": ["n"]}]
    )
    running.ready()
    until(lambda: hung_engine.calls, "a call of the engine")
    running.process.terminate()
    running.process.communicate(timeout=LIMIT_S)
    assert running.process.returncode == 0
    assert not running.marker.exists()


@pytest.mark.parametrize("where", HANGS)
def test_the_process_ends_in_time_whatever_hangs(start: Callable[..., Running], tmp_path: Path, where: str) -> None:
    """Even if the main thread hangs, or a reload when the signal arrives: the exit code says so, and the next start finds no crash."""
    script = tmp_path / "hangs.py"
    script.write_text(SHORT + HANGS[where] + RUN)
    running = start(str(script))
    running.ready()
    if where == "reload":
        running.write(interval="3s")
        running.process.send_signal(signal.SIGHUP)
        until(lambda: (tmp_path / "reloads").exists(), "the reload")
    running.process.terminate()
    _, errors = running.process.communicate(timeout=LIMIT_S)
    assert running.process.returncode == os.EX_SOFTWARE
    assert "PHM was not able to stop within 1 s and exits" in errors
    assert not running.marker.exists()


def test_phm_ends_before_it_would_be_killed() -> None:
    """With a second to spare, for what is shipped and for Docker's default; and its parts end before the process is ended."""
    docker_default_s = 10.0
    systemd = re.search(
        r"^TimeoutStopSec=(\d+)$", (ROOT / "config" / "systemd" / "phm.service").read_text(), re.MULTILINE
    )
    files = (ROOT / "docker" / "compose.yaml", ROOT / "phm" / "templates" / "compose.yaml")
    found = [
        systemd,
        *(re.search(r"^    stop_grace_period: (\d+)s$", file.read_text(), re.MULTILINE) for file in files),
    ]
    limits_s = [docker_default_s, *(float(one[1]) for one in found if one)]
    assert len(limits_s) == 4
    assert min(limits_s) >= END_S + 1
    assert STOP_S + SPARE_S <= END_S


def test_an_intended_shutdown_is_marked_before_anything_can_hang(tmp_path: Path, patient: Callable[..., None]) -> None:
    """A disk that hangs during the shutdown is named, uses only its own time limit, and does not count as a crash at
    the next start.
    """
    patient("state")
    daemon = _daemon(tmp_path)
    daemon.start()
    released, marked = threading.Event(), list[bool]()

    def hang() -> None:
        marked.append((tmp_path / "state" / MARKER).exists())
        released.wait()

    daemon.components.persistence.close = hang  # type: ignore[method-assign]
    assert daemon.stop() == ("state",)
    until(lambda: marked, "the step to begin")
    assert marked == [False]
    released.set()


class Waits(SystemClock):
    """A clock on which everything takes as long as it is waited for."""

    def __init__(self) -> None:
        super().__init__()
        self.waited_s = 0.0

    def mono(self) -> float:
        return self.waited_s

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        assert timeout_s is not None and timeout_s >= 0
        self.waited_s += timeout_s
        return False


@pytest.mark.parametrize("hanging", [1, 4, 40])
def test_all_waits_of_a_shutdown_together_are_within_its_budget(hanging: int) -> None:
    """However many parts hang, and the parts after them still get time."""
    clock, never = Waits(), threading.Event()
    closing = ShutdownSequence(clock, STOP_S)
    for number in range(hanging):
        closing.step(f"h{number}", never.wait, 3.0)
    before_s = clock.waited_s
    closing.step("last", never.wait, 3.0)
    assert clock.waited_s <= STOP_S + 1e-9
    assert clock.waited_s > before_s or hanging > 30
    never.set()


def test_hanging_steps_share_one_budget() -> None:
    """Each has its own limit, all together the budget; later steps still run, and an exception does not end the
    shutdown.
    """
    clock, never, ran = FakeClock(), threading.Event(), list[str]()
    closing = ShutdownSequence(clock, 5.0)
    over = threading.Event()

    def tick() -> None:
        while not over.wait(0.001):
            if clock.sleepers:
                clock.advance(0.05)

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
