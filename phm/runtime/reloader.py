"""Reloads the configuration: it is validated first, then a new daemon replaces the old one in the same process.

Links, control socket and watchdog stay open; open faults, attempts and budgets are handed over in memory; HEARTBEATs continue until
the new daemon sends its own. An invalid configuration changes nothing.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from phm.checking.plan import CheckPlan
from phm.config import ConfigError, Problem
from phm.core.dependency_graph import DependencyCycle
from phm.runtime.configuration import FIXED, Configuration, fixed_sections
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_successor
from phm.wire import control

logger = logging.getLogger(__name__)

ANSWER_S = 30.0
MAX_PROBLEMS, MAX_TEXT = 100, 500

ReadAgain = Callable[[], Configuration]
"""Reads and validates the configuration file again. Raises ConfigError."""


class HandoverFailed(Exception):
    """The present daemon has ended, and the new one could not be started: nothing is checked until PHM is restarted."""


@dataclass(frozen=True, slots=True)
class ReloadOutcome:
    """changed: sections that apply now. restart: changed sections that apply after a restart of PHM. why: the reason when not ok."""

    ok: bool
    changed: tuple[str, ...] = ()
    restart: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    why: str = ""

    def text(self) -> str:
        """The result in one sentence, for the log."""
        if not self.ok:
            detail = self.why or "; ".join(str(problem) for problem in self.problems[:3])
            return f"configuration not reloaded, the old one remains active: {detail}"
        applied = ", ".join(self.changed) or "no changes"
        later = f"; restart PHM to apply: {', '.join(self.restart)}" if self.restart else ""
        return f"configuration reloaded: {applied}{later}"

    def as_json(self) -> str:
        """As JSON, with as many of the `total` problems as the control socket's answer can have."""
        kept = [{**asdict(each), "text": str(each)} for each in self.problems[:MAX_PROBLEMS]]
        kept = [{name: _cut(value) for name, value in each.items()} for each in kept]
        document = {**asdict(self), "why": _cut(self.why), "text": _cut(self.text()), "total": len(self.problems)}
        while True:
            text = json.dumps({**document, "problems": kept})
            if len(json.dumps(text)) <= control.MAX_ANSWER - MAX_TEXT:  # the answer has it as a text in JSON
                return text
            kept = kept[: len(kept) // 2]


def _cut(value: Any) -> Any:
    return value if not isinstance(value, str) or len(value) <= MAX_TEXT else f"{value[: MAX_TEXT - 3]}..."


@dataclass
class _Request:
    """One `phm reload` that waits for its outcome."""

    done: threading.Event = field(default_factory=threading.Event)
    outcome: ReloadOutcome | None = None


class Reloader:
    """Any thread may call `request`; only the main thread, which owns the daemon, may call `run`."""

    def __init__(self, read: ReadAgain) -> None:
        self._read = read
        self._lock = threading.Lock()
        self._waiting: list[_Request] = []

    def request(self) -> str:
        """Have the main thread reload, wait for it, and return the outcome as JSON."""
        request = _Request()
        with self._lock:
            self._waiting.append(request)
        os.kill(os.getpid(), signal.SIGHUP)
        if not request.done.wait(ANSWER_S) or request.outcome is None:
            return ReloadOutcome(False, why=f"PHM did not answer within {ANSWER_S:g} s").as_json()
        return request.outcome.as_json()

    def run(self, daemon: Daemon) -> Daemon:
        """Reload; returns the daemon that runs from now on. Raises nothing but HandoverFailed."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        try:
            daemon, outcome = self._reload(daemon)
        except HandoverFailed:
            raise
        except Exception as error:  # a defect here must not end PHM
            logger.exception("the configuration could not be reloaded")
            outcome = ReloadOutcome(False, why=f"{type(error).__name__}: {error}")
        if not outcome.ok:
            for problem in outcome.problems:
                logger.error("%s", problem)
        daemon.pipeline.note("PHM", outcome.text())
        for request in waiting:
            request.outcome = outcome
            request.done.set()
        return daemon

    def _reload(self, daemon: Daemon) -> tuple[Daemon, ReloadOutcome]:
        try:
            wanted = self._read()
        except ConfigError as error:
            return daemon, ReloadOutcome(False, problems=error.problems)
        old = daemon.components.settings
        sections = [name for name in type(old).model_fields if getattr(old, name) != getattr(wanted.settings, name)]
        restart = tuple(name for name in sections if name in FIXED)
        changed = tuple(name for name in sections if name not in FIXED)
        if not changed:
            return daemon, ReloadOutcome(True, restart=restart)
        if why := daemon.why_not_reload():
            return daemon, ReloadOutcome(False, why=why)
        usable = wanted.settings
        plan: CheckPlan | None = wanted.plan
        if restart:  # the checks of the file are those after the restart: others are built for what applies now
            usable, plan = usable.model_copy(update=fixed_sections(old)), None
        try:
            new = build_successor(daemon, usable, plan)
        except (
            DependencyCycle
        ) as error:  # after any other error, a defect, the present daemon goes on as well: `run` reports it
            return daemon, ReloadOutcome(False, why=f"checks: {error}")
        try:
            new.start()
        except Exception as error:  # a defect, or no memory for another thread
            raise HandoverFailed(f"{type(error).__name__}: {error}") from error
        return new, ReloadOutcome(True, changed, restart)
