"""Sends the operator's requests to agents and keeps their answers: the same commands as `phm gcs approve` and the keys of the table.

`submit` is called by the server's thread; the answers come in the thread of the feed.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phm.core.clock import Clock
from phm.gcs import operator
from phm.gcs.operator import Exchange, OperatorCommand
from phm.gcs.station import GroundStation, Received
from phm.gcs.subscriber_queue import QueuedEvent
from phm.gcs.web.choices import choices, command_of
from phm.gcs.web.site import RequestRefused
from phm.gcs.web.view import View

Json = dict[str, Any]
KEPT = 50
LATE_S = 60.0
"""Seconds after a request was given up in which an answer still counts."""
MAX_OPEN = 32


@dataclass(slots=True)
class _Sent:
    number: int
    agent: str
    what: str
    by: str
    exchange: Exchange
    sent_utc: float
    over_at: float | None = None
    """When its answer was complete, or it was given up; monotonic."""
    done_utc: float | None = None

    @property
    def waits(self) -> bool:
        return self.over_at is None

    def json(self) -> Json:
        one = self.exchange
        timed_out = one.result == "TIMEOUT"
        answered = bool(one.result) and not timed_out
        return {
            "id": self.number,
            "agent": self.agent,
            "do": self.what,
            "text": one.command.text,
            "state": "sent" if self.waits else "timeout" if timed_out else "answered",
            "accepted": one.accepted if answered else None,
            "result": one.result,
            "reply": one.reply,
            "sentence": f"{one.answer()}{' (late)' if one.late else ''}" if not self.waits else "",
            "by": self.by,
            "sent_utc_s": round(self.sent_utc, 3),
            "done_utc_s": None if self.done_utc is None else round(self.done_utc, 3),
            "late": one.late,
        }


class RequestHandler:
    """Sends requests and keeps the last ones with their answers. Thread-safe."""

    def __init__(self, station: GroundStation, view: View, clock: Clock) -> None:
        self._station, self._view, self._clock = station, view, clock
        self._sent: deque[_Sent] = deque(maxlen=KEPT)
        self._number = 0
        self._lock = threading.Lock()

    def choices(self, agent: str) -> Json:
        """What can be requested of an agent now. Raises RequestRefused."""
        row = self._row(agent)
        note = self._problem(row)
        return {"choices": choices(row) if not note else [], "note": note}

    def submit(self, body: Mapping[str, Any], by: str) -> Json:
        """Send a request. Raises RequestRefused, and ValueError for an invalid body."""
        name = body.get("agent")
        if not isinstance(name, str):
            raise ValueError("agent must be the name of an agent")
        row = self._row(name)
        command = command_of(body, row)
        if problem := self._problem(row):
            raise RequestRefused(f"{name} {command.text}: not sent, {problem}")
        with self._lock:
            waiting = [one for one in self._sent if one.waits]
            earlier = next((one for one in waiting if one.exchange.blocks(name, command)), None)
            if earlier is not None:
                raise RequestRefused(
                    f"{name} {command.text}: not sent, still waiting for the answer to {earlier.exchange.command.text}"
                )
            if len(waiting) >= MAX_OPEN:
                raise RequestRefused(f"{name} {command.text}: not sent, {MAX_OPEN} requests are still unanswered")
            sent = self._send(row, command, str(body["do"]), by)
        self._publish([sent])
        return sent.json()

    def recent(self) -> list[Json]:
        with self._lock:
            return [one.json() for one in self._sent]

    # ------------------------------------------------------------ the thread of the feed

    def frame(self, received: Received) -> None:
        """Ignore frames: answers arrive as events."""

    def event(self, item: QueuedEvent, line: Mapping[str, Any]) -> None:
        now = self._clock.mono()
        with self._lock:
            waiting = [one for one in self._sent if one.waits]
            for one in waiting:
                one.exchange.receive(item.event, now)
            late = [one for one in self._sent if self._may_be_late(one, waiting, now)]
            before = [(one.exchange.late, one.exchange.reply) for one in late]
            for one in late:
                one.exchange.receive(item.event, now)
            changed = [
                one
                for one, was in zip(late, before, strict=True)
                if (one.exchange.late, one.exchange.reply) != was and one.exchange.late
            ]
            for one in changed:
                one.done_utc = self._clock.utc()
        self._publish(changed)

    def tick(self, now: float) -> None:
        with self._lock:
            done = [one for one in self._sent if one.waits and one.exchange.done(now)]
            for one in done:
                one.over_at, one.done_utc = now, self._clock.utc()
        self._publish(done)

    # ------------------------------------------------------------

    def _send(self, row: Json, command: OperatorCommand, what: str, by: str) -> _Sent:
        if command == operator.list_containers():
            self._station.forget_containers(row["agent"], row["component"])

        def transmit(confirmation: int, nonce: float) -> None:
            self._station.command(row["agent"], row["component"], command, confirmation, nonce, row["link"] or "")

        self._number += 1
        exchange = Exchange(row["name"], command, transmit, self._clock.mono())
        self._sent.append(_Sent(self._number, row["name"], what, by, exchange, self._clock.utc()))
        return self._sent[-1]

    def _may_be_late(self, one: _Sent, waiting: list[_Sent], now: float) -> bool:
        """A COMMAND_ACK names the command's number alone: it is that of a newer request while one waits."""
        if (
            one.over_at is None
            or now - one.over_at > LATE_S
            or not (one.exchange.late or one.exchange.result == "TIMEOUT")
        ):
            return False
        newer = [other for other in self._sent if other.number > one.number]
        return not any(other.exchange.blocks(one.agent, one.exchange.command) for other in [*waiting, *newer])

    def _row(self, name: str) -> Json:
        row = self._view.row(name)
        if row is None:
            raise RequestRefused(f"there is no agent {name}"[:200])
        return row

    def _problem(self, row: Json) -> str:
        """Why no request can be sent to this agent, else empty."""
        if self._station.silent:
            return "phm gcs --silent sends nothing"
        return "" if row["presence"] in ("alive", "late") else f"the agent is {row['presence']}"

    def _publish(self, changed: list[_Sent]) -> None:
        if changed:
            self._view.publish("requests", {"requests": [one.json() for one in changed]})
