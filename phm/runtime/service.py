"""The process of `phm run`: one PHM for its directories, signals, and an end within the time that Docker gives."""

from __future__ import annotations

import logging
import os
import signal

from phm.core.clock import SystemClock
from phm.core.instance_lock import InstanceLock
from phm.core.process_priority import apply
from phm.core.settings import Settings
from phm.core.signals import Signals
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.daemon import LOOK_S, STALLED_END_S, Daemon
from phm.runtime.reload import Read, Reloader

logger = logging.getLogger(__name__)

ENDING = frozenset((signal.SIGTERM, signal.SIGINT))


def run(settings: Settings, read: Read | None = None) -> int:
    """Run until SIGTERM or SIGINT; 0 after an orderly end. SIGHUP has `read` give the configuration again. Raises AlreadyRunning.

    Ends the process with 70 (EX_SOFTWARE) when the engine has stalled: restart policies act on that.
    """
    lock = InstanceLock(settings.state_dir, settings.run_dir)
    lock.acquire()
    guard = DaemonWatchdog()
    priority = apply(settings.process)
    clock = SystemClock()
    clock.measure()
    daemon = Daemon(settings, clock, guard)
    daemon.own_problems += [lambda: lock.problem, lambda: priority.problem]
    reloader = Reloader(read or (lambda: settings), guard)
    with Signals(*ENDING, signal.SIGCONT, signal.SIGHUP) as signals:
        daemon.start()
        guard.start()
        if daemon.control is not None:
            daemon.control.reload = reloader.ask
        daemon = _serve(daemon, signals, reloader)
        hung = daemon.stop()
        lock.release()
        if hung:
            logger.critical("PHM ends without waiting any longer for: %s", ", ".join(hung))
    return os.EX_OK


def _serve(daemon: Daemon, signals: Signals, reloader: Reloader) -> Daemon:
    """Until a signal ends it; the daemon that runs then."""
    while True:
        if not daemon.look():
            logger.critical("PHM has stalled for %.0f s and exits so that it is restarted", STALLED_END_S)
            logging.shutdown()
            os._exit(os.EX_SOFTWARE)  # an orderly end would wait for what hangs
        for number in signals.wait(LOOK_S):
            if number in ENDING:
                return daemon
            if number == signal.SIGCONT:
                daemon.beat_soon()
            if number == signal.SIGHUP:
                daemon = reloader.run(daemon)
