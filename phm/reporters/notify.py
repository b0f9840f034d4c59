"""Alerts elsewhere: a webhook, MQTT or any other service of Apprise, and a command, when a fault opens, closes or is given up.

Nothing here waits: a separate thread sends. What is too much is counted, and the next alert says how many were left out.
"""

from __future__ import annotations

import contextlib
import json
import logging
import subprocess
import threading
from collections.abc import Callable, Sequence
from typing import Any

from phm.core import process_group, threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.extras import remedy
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Outcome, Phase
from phm.core.rate_limiter import RateLimiter
from phm.reporters.base import Reporter, ReporterContext
from phm.wire.report import fault_json
from phm.wire.status_line import agent_name

MISSING = f"notify.urls needs Apprise: {remedy('notify')}, or build the image with EXTRAS=notify"
MAX_WAITING = 100
COMMAND_S = 10.0
CLOSE_LIMIT_S = 2.0
_TOO_MANY = "more than notify.per_minute, or sending takes too long"
_ENDS = {Outcome.RESOLVED: "success", Outcome.REATTRIBUTED: "info"}
"""Apprise's type of the notification that a fault is closed. One with another outcome, or that is not closed: failure."""

Alert = dict[str, Any]
Send = Callable[[Alert], str]
"""Sends an alert; why that failed, else empty."""


class NotifyReporter(Reporter):
    """Sends alerts to other services; see the module."""

    name = "notify"
    kinds = (FaultOpened, FaultClosed, ActionEvent)

    def __init__(self, context: ReporterContext, senders: Sequence[Send]) -> None:
        settings = context.settings.notify
        self._agent, self._clock, self._senders = context.settings.agent, context.clock, tuple(senders)
        self._events = frozenset(settings.events)
        self._why: dict[str, str] = {}
        """Why PHM gives up on faults, by their id."""
        self._limiter = RateLimiter(settings.per_minute / 60.0, float(settings.per_minute))
        self._queue: BoundedQueue[tuple[int, Alert]] = BoundedQueue(context.clock, MAX_WAITING)
        """Alerts with their numbers, which show what was left out."""
        self._number = self._sent = 0
        self._problem = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-notify", daemon=True)
        threads.start(self._thread)

    @classmethod
    def build(cls, context: ReporterContext) -> NotifyReporter | None:
        settings = context.settings.notify
        senders: list[Send] = [lambda alert: send_to_urls(alert, settings.urls)] if settings.urls else []
        if settings.command:
            senders.append(AlertCommand(settings.command))
        return cls(context, senders) if senders else None

    def handle(self, event: Event) -> None:
        if isinstance(event, FaultOpened):
            self._put("open", event.fault)
        elif isinstance(event, FaultClosed):
            why = self._why.pop(event.fault.id, "")
            if event.fault.outcome is Outcome.ESCALATED:
                self._put("escalate", event.fault, why)
            else:
                self._put("close", event.fault)
        elif isinstance(event, ActionEvent) and event.phase is Phase.ESCALATED:
            self._why[event.fault] = event.detail  # the fault is closed next
            while len(self._why) > MAX_WAITING:
                del self._why[next(iter(self._why))]

    def close(self) -> None:
        """Send what waits, for at most CLOSE_LIMIT_S."""
        self._stop.set()
        self._queue.wake()
        threads.join(self._thread, CLOSE_LIMIT_S)

    def problem(self) -> str:
        return f"notify: {self._problem}" if self._problem else ""

    def _put(self, event: str, fault: Fault, detail: str = "") -> None:
        if event not in self._events:
            return
        self._number += 1
        if not self._limiter.allow(self._clock.mono()):
            return
        words = {"open": "FAIL", "close": fault.outcome.value.upper(), "escalate": "GAVE UP"}[event]
        brief = fault.result.brief or fault.unit
        body = detail or f"{fault.unit}: {fault.result.summary}"
        alert = {
            "event": event,
            "agent": self._agent.name,
            "agent_id": self._agent.id,
            "title": f"{agent_name(self._agent.id)} {words} {int(fault.slot)} {brief}",
            "body": f"{self._agent.name}: {body}",
            "left_out": 0,
            "type": _ENDS.get(fault.outcome, "failure") if event == "close" else "failure",
            "fault": fault_json(fault),
        }
        self._queue.put((self._number, alert))

    def _loop(self) -> None:
        last = False
        while not last:
            last = self._stop.is_set()
            for number, alert in self._queue.take(0.0 if last else 1.0):
                left_out, self._sent = number - self._sent - 1, number
                if left_out:
                    alert["left_out"] = left_out
                    alert["body"] += f" ({left_out} alerts before this one were left out: {_TOO_MANY})"
                problems = [problem for send in self._senders if (problem := _guarded(send, alert))]
                self._problem = "; ".join(problems)


def send_to_urls(alert: Alert, urls: Sequence[str]) -> str:
    """By Apprise, which is imported at the first alert."""
    try:
        import apprise
    except ImportError:
        return MISSING
    logging.getLogger("apprise").setLevel(logging.CRITICAL)  # its messages contain passwords of URLs
    target = apprise.Apprise()
    refused = [number for number, url in enumerate(urls) if not target.add(url)]
    if refused:
        return f"notify.urls[{refused[0]}] is not a URL that Apprise knows"
    # Else e-mail and Telegram take the text for HTML, and it contains names and outputs from outside.
    plain = apprise.NotifyFormat.TEXT
    sent = target.notify(title=alert["title"], body=alert["body"], notify_type=alert["type"], body_format=plain)
    return "" if sent else "an alert could not be sent to all of notify.urls: address, network or password"


class AlertCommand:
    """Runs a command with the alert as a JSON object on its standard input. No shell is used."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._hung: subprocess.Popen[bytes] | None = None

    def __call__(self, alert: Alert) -> str:
        name = self._command[0]
        if self._hung is not None and self._hung.poll() is None:
            return f"{name} of an earlier alert was killed and has not ended"
        try:
            program = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            return f"{name} cannot be started: {error.strerror or error}"
        try:
            program.communicate(json.dumps(alert).encode("ascii"), COMMAND_S)
        except subprocess.TimeoutExpired:
            self._hung = None if process_group.end(program) else program
            with contextlib.suppress(OSError):
                program.stdin.close()  # type: ignore[union-attr]  # a pipe was requested
            return f"{name} did not end within {COMMAND_S:g} s and was killed"
        return "" if program.returncode == 0 else f"{name} ended with exit code {program.returncode}"


def _guarded(send: Send, alert: Alert) -> str:
    try:
        return send(alert)
    except Exception as error:  # a library of others: the next alert must still be sent
        return f"{type(error).__name__} while an alert was sent"
