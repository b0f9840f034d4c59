"""The status file, from which `phm status` and the container's HEALTHCHECK read the state of the running daemon.

Written atomically to ``run_dir/status.json`` every two seconds and on change; removed at the end. When it is
valid is in `phm.wire.status_file`; its keys are in `docs/reference/cli.md`.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections import deque
from dataclasses import replace
from typing import Any

from phm import __version__
from phm.core.model import (
    ActionEvent,
    Event,
    Fault,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Outcome,
    Report,
    Transition,
    worst_by_slot,
)
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.open_faults import OpenFaults
from phm.wire import status_word
from phm.wire.report import fault_json, iso, report_json
from phm.wire.status_file import NAME, place

logger = logging.getLogger(__name__)

VERSION = 2
CLOSED_FAULTS = 20
ALONG_S = 0.1
"""Changes within this time of the last writing wait for the next tick, so that a burst costs one writing."""


class StatusReporter(Reporter):
    """Keeps `run_dir/status.json` fresh."""

    name = "status"
    period_s = 2.0
    kinds = (Transition, FaultOpened, FaultClosed, ActionEvent, HoldChanged, Report)

    def __init__(self, context: ReporterContext) -> None:
        self._context, self._agent, self._interval_s = context, context.settings.agent, context.settings.interval_s
        self._path = os.path.join(context.settings.run_dir, NAME)
        self._place = place()
        self._open = OpenFaults(context.restored)
        self._closed: deque[Fault] = deque(maxlen=CLOSED_FAULTS)
        self._written_at = float("-inf")
        self._problem = ""
        self._warned = False

    @classmethod
    def build(cls, context: ReporterContext) -> StatusReporter:
        return cls(context)

    def handle(self, event: Event) -> None:
        self._open.take(event)
        if isinstance(event, FaultClosed):
            self._closed.append(event.fault)
        if self._context.clock.mono() - self._written_at >= ALONG_S:
            self._write()

    def tick(self) -> None:
        self._write()

    def close(self) -> None:
        # A file that stays would be refused after 5 s anyway; without it the reason is clear immediately.
        with contextlib.suppress(OSError):
            os.unlink(self._path)

    def hand_over(self) -> None:
        """Keep the file: the next reporter continues."""

    def problem(self) -> str:
        return self._problem

    def _write(self) -> None:
        self._written_at = self._context.clock.mono()
        temporary = f"{self._path}.{os.getpid()}.tmp"
        try:
            os.makedirs(os.path.dirname(self._path), exist_ok=True)
            with open(temporary, "w", encoding="ascii") as stream:
                stream.write(json.dumps(self._document(), default=str))  # dump() would encode in Python, 4 times slower
                os.fchmod(stream.fileno(), 0o644)
            os.replace(temporary, self._path)
            self._problem = ""
        except OSError as error:
            self._problem = f"cannot write {self._path}: {error.strerror or error}; `phm status` does not work"
            if not self._warned:  # `phm status` cannot show it
                self._warned = True
                logger.warning("%s", self._problem)
            with contextlib.suppress(OSError):
                os.unlink(temporary)

    def _document(self) -> dict[str, Any]:
        context = self._context
        states = context.states()
        now = context.clock.stamp()
        agent = self._agent
        blocked: dict[str, list[str]] = {}
        for state in states:
            if state.blocked_by:
                blocked.setdefault(state.blocked_by, []).append(state.unit)
        # Events report which faults are open, the tracker their current state.
        current = {**self._open, **{fault.id: fault for fault in context.open_faults()}}
        opened = [fault_json(fault, blocks=blocked.get(fault.unit, ())) for fault in current.values()]
        given_up = [
            fault_json(replace(fault, outcome=Outcome.ESCALATED), blocks=blocked.get(fault.unit, ()))
            for fault in context.given_up()
        ]
        return {
            "v": VERSION,
            **report_json(agent.name, states),
            "agent_id": agent.id,
            "boot_id": context.boot_id,
            "pid": os.getpid(),
            **self._place,
            "version": __version__,
            "written_utc": iso(now.utc),
            "written_mono": now.mono,
            "interval_s": self._interval_s,
            "alive": context.alive(),
            "armed": context.armed(),
            "status_word": status_word.encode(worst_by_slot(states)),
            "holds": context.holds(),
            "faults": {
                "open": opened,
                "given_up": given_up,
                "closed": [fault_json(fault) for fault in self._closed],
            },
            "health": context.health(),
        }
