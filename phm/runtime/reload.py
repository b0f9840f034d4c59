"""Reloading the configuration: validated first, then a new daemon takes the place of the old one in the same process.

Links, control socket and guard go on, open faults, attempts and budgets are handed over in memory, and heartbeats go on until the
new daemon sends its own. A configuration that is not valid changes nothing.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from phm.config import ConfigError, Problem
from phm.core.dependency_graph import DependencyCycle
from phm.core.settings import Settings
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.daemon import Daemon

logger = logging.getLogger(__name__)

FIXED = ("agent", "mavlink", "process", "state_dir", "run_dir")
"""Sections that cannot change at run time: who the agent is, its links, its priority, and the directories that are locked."""
ANSWER_S = 30.0
MAX_PROBLEMS = 100

Read = Callable[[], Settings]
"""Reads and validates the configuration file again. Raises ConfigError."""


@dataclass(frozen=True, slots=True)
class ReloadOutcome:
    """What came of it. `changed`: sections that apply now; `restart`: those that need a restart of PHM and stay as they were."""

    ok: bool
    changed: tuple[str, ...] = ()
    restart: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    why: str = ""

    def text(self) -> str:
        """In a sentence, for the log."""
        if not self.ok:
            detail = self.why or "; ".join(str(problem) for problem in self.problems[:3])
            return f"configuration not reloaded, the old one stays: {detail}"
        applied = ", ".join(self.changed) or "nothing has changed"
        later = f"; a restart of PHM is needed for: {', '.join(self.restart)}" if self.restart else ""
        return f"configuration reloaded: {applied}{later}"

    def as_json(self) -> str:
        document = {**asdict(self), "text": self.text()}
        document["problems"] = [{**asdict(each), "text": str(each)} for each in self.problems[:MAX_PROBLEMS]]
        return json.dumps(document)


@dataclass
class _Asked:
    """One `phm reload` that waits for its answer."""

    done: threading.Event = field(default_factory=threading.Event)
    outcome: ReloadOutcome | None = None


class Reloader:
    """`ask` may be called by any thread; `run` by the main thread alone, which owns the daemon."""

    def __init__(self, read: Read, guard: DaemonWatchdog) -> None:
        self._read, self._guard = read, guard
        self._lock = threading.Lock()
        self._waiting: list[_Asked] = []

    def ask(self) -> str:
        """Have the main thread reload; the outcome as JSON. Waits for it."""
        asked = _Asked()
        with self._lock:
            self._waiting.append(asked)
        os.kill(os.getpid(), signal.SIGHUP)
        if not asked.done.wait(ANSWER_S) or asked.outcome is None:
            return ReloadOutcome(False, why=f"PHM has not come to it within {ANSWER_S:g} s").as_json()
        return asked.outcome.as_json()

    def run(self, daemon: Daemon) -> Daemon:
        """Reload; the daemon that runs from now on. Never raises."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        try:
            daemon, outcome = self._reload(daemon)
        except Exception as error:  # a defect here must not end PHM
            logger.exception("the configuration could not be reloaded")
            outcome = ReloadOutcome(False, why=f"{type(error).__name__}: {error}")
        if not outcome.ok:
            for problem in outcome.problems:
                logger.error("%s", problem)
        daemon.pipeline.note("PHM", outcome.text())
        for asked in waiting:
            asked.outcome = outcome
            asked.done.set()
        return daemon

    def _reload(self, daemon: Daemon) -> tuple[Daemon, ReloadOutcome]:
        try:
            wanted = self._read()
        except ConfigError as error:
            return daemon, ReloadOutcome(False, problems=error.problems)
        old = daemon.settings
        sections = [name for name in type(old).model_fields if getattr(old, name) != getattr(wanted, name)]
        restart = tuple(name for name in sections if name in FIXED)
        changed = tuple(name for name in sections if name not in FIXED)
        if not changed:
            return daemon, ReloadOutcome(True, restart=restart)
        if busy := daemon.acting():
            return daemon, ReloadOutcome(False, why=f"an action is under way ({busy}): reload again when it has ended")
        usable = wanted.model_copy(update={name: getattr(old, name) for name in FIXED})
        try:
            new = Daemon(usable, daemon.clock, self._guard, before=daemon)
        except DependencyCycle as error:
            daemon.keep_links()
            return daemon, ReloadOutcome(False, why=f"checks: {error}")
        except Exception:
            daemon.keep_links()
            raise
        new.start()
        return new, ReloadOutcome(True, changed, restart)
