"""The process of `phm run`: one instance per directory, signals, and an end within the time that Docker allows."""

from __future__ import annotations

import logging
import os
import signal
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import NoReturn

from phm.core import memory, threads
from phm.core.clock import SystemClock
from phm.core.instance_lock import InstanceLock
from phm.core.process_priority import apply
from phm.core.signals import Signals
from phm.core.systemd import SystemdNotifier
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.configuration import Configuration
from phm.runtime.daemon import STALLED_END_S, SUPERVISE_S, Daemon
from phm.runtime.reloader import HandoverFailed, ReadAgain, Reloader
from phm.runtime.wiring import build_daemon, build_delivery

logger = logging.getLogger(__name__)

ENDING = frozenset((signal.SIGTERM, signal.SIGINT))
END_S = 9.0
"""The process ends this long after the first of these signals, whatever hangs. Docker sends SIGKILL after 10 s by default, the shipped
systemd unit too, the shipped compose files after 15 s."""
SPARE_S = 1.0
"""What is left of that time when the daemon has ended: to release the lock, and to name what hangs."""


@dataclass
class _Running:
    """The daemon that runs now; a reload replaces it."""

    daemon: Daemon


def run(configuration: Configuration, read: ReadAgain) -> int:
    """Run until SIGTERM or SIGINT; 0 after an orderly end. read: reads the configuration again, on SIGHUP. Raises AlreadyRunning.

    Exits with 70 (EX_SOFTWARE) when the scheduler has stalled, or a reload failed halfway: restart policies act on that.
    """
    settings = configuration.settings
    lock = InstanceLock(settings.state_dir, settings.run_dir)
    lock.acquire()
    watchdog = DaemonWatchdog()
    priority = apply(settings.process)
    clock = SystemClock()
    clock.measure()
    systemd = SystemdNotifier(clock)
    reloader = Reloader(read)
    server, unusable = build_delivery(configuration, clock, lambda: running.daemon, reloader.request)
    problems = (
        threads.problem,
        lambda: lock.problem,
        lambda: priority.problem,
        server.problem if server else lambda: unusable,
    )
    running = _Running(
        build_daemon(settings, clock, watchdog, plan=configuration.plan, problems=problems, reload=reloader.request)
    )
    signal.signal(signal.SIGALRM, partial(_overdue, running))
    with Signals(*ENDING, signal.SIGCONT, signal.SIGHUP, handler=_limit_the_end) as signals:
        running.daemon.start()
        watchdog.start()
        if server is not None:
            server.start()
        systemd.ready()
        memory.give_back()
        _serve(running, signals, reloader, systemd)
        systemd.stopping()
        left_s = signal.getitimer(signal.ITIMER_REAL)[0]
        hung = running.daemon.stop(left_s - SPARE_S, server.close if server is not None else None)
        lock.release()
        if hung:
            logger.critical("PHM exits although these parts still hang: %s", ", ".join(hung))
    return os.EX_OK


def _serve(running: _Running, signals: Signals, reloader: Reloader, systemd: SystemdNotifier) -> None:
    """Supervise until a signal ends it."""
    while True:
        if not running.daemon.supervise():
            logger.critical("PHM has stalled for %.0f s and exits so that it is restarted", STALLED_END_S)
            _exit()
        if running.daemon.alive:
            systemd.watchdog()
        for number in signals.wait(SUPERVISE_S):
            if number in ENDING:
                return
            if number == signal.SIGCONT:
                running.daemon.wake()
            if number == signal.SIGHUP:
                systemd.reloading()
                try:
                    running.daemon = reloader.run(running.daemon)
                except HandoverFailed:
                    logger.critical(
                        "PHM could not start again after a reload and exits so that it is restarted", exc_info=True
                    )
                    _exit()
                systemd.ready()


def _limit_the_end(number: int, frame: FrameType | None) -> None:
    """A handler: the main thread may be in a reload, and read the signal only after it."""
    if number in ENDING and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0:
        signal.setitimer(signal.ITIMER_REAL, END_S)


def _overdue(running: _Running, number: int, frame: FrameType | None) -> NoReturn:
    """A handler, so it takes no lock: the interrupted code may hold it. This end was requested and is none of a crash."""
    running.daemon.marker.end()
    os.write(2, f"phm: CRITICAL: PHM was not able to stop within {END_S:g} s and exits\n".encode())
    os._exit(os.EX_SOFTWARE)


def _exit() -> NoReturn:
    """End the process immediately: an orderly stop would wait for what hangs."""
    logging.shutdown()
    os._exit(os.EX_SOFTWARE)
