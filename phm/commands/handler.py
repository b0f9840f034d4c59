"""Takes commands from the links, has them judged, carries them out and acknowledges each to its asker.

A command passes: addressed to us? known? signed, allowed, well-formed (`judge`)? not too many (`Gate`)? not done before
(`Memory`)? Only then is anything done. The endpoints' threads judge and queue; the rest is the desk's own thread.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from phm.commands import responses
from phm.commands.authorize import Do, Ignore, Refuse, addressed, judge
from phm.commands.ledger import Ledger
from phm.commands.rate_limit import Gate, Memory
from phm.commands.services import Port, Powers
from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Fault
from phm.core.settings import Settings
from phm.transport.priority import Class
from phm.wire import command
from phm.wire.command import (
    COMMAND_INT,
    COMMAND_LONG,
    HEARTBEAT,
    READS,
    Approve,
    Asked,
    Look,
    Repeat,
    Restart,
    Result,
    Send,
    Tell,
    Wish,
)

__all__ = ["Desk", "Port", "Powers"]

logger = logging.getLogger(__name__)

KIND = "COMMAND"
MAX_WAITING = 64
"""Of those that are signed, and of those that are not: these must not keep the others out."""
MAX_REPEATS = 64
CHECK_EVERY_S = 2.0
HEARTBEAT_EVERY_S = 1.0
"""HEARTBEATs are not held back by the budget, so asking for them must not become a way around it."""
UNSIGNED_LAST = 9
IDLE_S = 1.0
CLOSING_S = 2.0


class Desk:
    """See the module. Making it listens; `start` begins to answer."""

    def __init__(self, port: Port, powers: Powers, settings: Settings, clock: Clock) -> None:
        self._port, self._powers, self._settings, self._clock = port, powers, settings, clock
        self._allowed = frozenset(settings.mavlink.commands)
        self._gate, self._memory = Gate(), Memory()
        self._waiting: dict[bool, deque[tuple[Asked, bytes, Do | Refuse]]] = {True: deque(), False: deque()}
        """Signed ones, which are answered first, and others."""
        self._ledger = Ledger()
        self._repeats: dict[tuple[str, int], tuple[float, float, Asked]] = {}
        """By link and message: seconds between, when it is due, and who asked."""
        self._looked = self._beat = float("-inf")
        self._lock = threading.Lock()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-inbound", daemon=True)
        port.listen(self.hear, (COMMAND_LONG, COMMAND_INT))

    def start(self) -> None:
        threads.start(self._thread)

    def close(self) -> None:
        """End the thread; waits at most CLOSING_S."""
        self._stop.set()
        self._wake.set()
        threads.join(self._thread, CLOSING_S)

    # ------------------------------------------------------------ the endpoints' threads

    def hear(self, message: Any, link: str) -> None:
        """A COMMAND_LONG or COMMAND_INT. Queues and never waits."""
        ours = (self._port.system_id, self._port.component_id)
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if sender == ours or not addressed(message.target_system, message.target_component, *ours):
            return
        asked = Asked(
            message.command,
            (message.param1, message.param2),
            getattr(message, "confirmation", 0),
            *sender,
            link,
            bool(message.get_signed()),
            whole=message.target_component == 0,
            age_s=getattr(message, "_age_s", 0.0),
        )
        limit_s = self._settings.mavlink.signing.command_age
        verdict = judge(asked, self._allowed, signing=self._port.signs, command_age_s=limit_s)
        if isinstance(verdict, Ignore):
            return
        with self._lock:
            lets = self._gate.lets(link, *sender, asked.signed, self._clock.mono())
            waiting = self._waiting[asked.signed]
            if not lets or len(waiting) >= MAX_WAITING:
                self._ledger.dropped()
                return
            waiting.append((asked, bytes(message.get_msgbuf()), verdict))
        self._wake.set()

    # ------------------------------------------------------------ the desk's thread

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._wake.clear()
            try:
                wait_s = self.turn()
            except Exception:  # one command must not end the answering of all
                logger.exception("a command stumbled")
                wait_s = IDLE_S
            self._clock.wait(self._wake, wait_s)

    def turn(self) -> float:
        """Answer what waits and send what is due; seconds until something is due again."""
        while not self._stop.is_set():
            with self._lock:
                waiting = self._waiting[True] or self._waiting[False]
                if not waiting:
                    break
                asked, frame, verdict = waiting.popleft()
            self._answer(asked, frame, verdict)
        with self._lock:
            lines = self._ledger.due(self._clock.mono())
        for line in lines:
            self._powers.note(KIND, line)
        return self._repeat()

    def _answer(self, asked: Asked, frame: bytes, verdict: Do | Refuse) -> None:
        now = self._clock.mono()
        before = self._memory.before(asked, frame, now)
        if before is not None:
            self._acknowledge(asked, before)
            return
        if isinstance(verdict, Refuse):
            result, words = verdict.result, verdict.why
        else:
            result, words = self._carry_out(verdict.wish, asked)
        self._memory.did(asked, frame, result, now)
        self._acknowledge(asked, result)
        acts = isinstance(verdict, Do) and isinstance(verdict.wish, (Approve, Restart))
        with self._lock:
            logs = self._ledger.logs(asked, result, now, acts=acts)
        if logs:
            signed = "signed" if asked.signed else "unsigned"
            shown = f"{result.name.lower()}: {_shown(asked, verdict)}"
            self._powers.note(KIND, f"{shown} from {asked.sender} by {asked.link}, {signed}: {words}")

    def _acknowledge(self, asked: Asked, result: Result) -> None:
        # Where the link has room for few answers, those to senders that anybody can make up come last.
        urgency = UNSIGNED_LAST if self._port.signs and not asked.signed else 0
        key = f"ack {asked.sender} {asked.command} {asked.signed}"
        self._port.send(responses.ack(asked, result), Class.REQUEST, key=key, urgency=urgency, link=asked.link)

    def _carry_out(self, wish: Wish, asked: Asked) -> tuple[Result, str]:
        """Do it; the result and what to note. Whatever goes wrong is FAILED, with the reason."""
        try:
            if asked.signed and command.word(wish) not in READS:
                if problem := self._powers.clock_problem():
                    return Result.TEMPORARILY_REJECTED, problem
                self._powers.remember()
            return self._do(wish, asked)
        except self._powers.later as error:
            return Result.TEMPORARILY_REJECTED, str(error)
        except Exception as error:
            return Result.FAILED, str(error) or type(error).__name__

    def _do(self, wish: Wish, asked: Asked) -> tuple[Result, str]:
        if isinstance(wish, Send):
            return self._send(wish.message, asked.link)
        if isinstance(wish, Tell):
            return self._details(wish.fault, asked)
        if isinstance(wish, Repeat):
            return self._keep_sending(wish, asked)
        if isinstance(wish, Look):
            return self._look()
        if isinstance(wish, Approve):
            faults = _numbered(self._powers.open_faults(), wish.fault)
            if len(faults) != 1:
                return Result.FAILED, f"{'no' if not faults else 'more than one'} open fault has number {wish.fault}"
            return Result.ACCEPTED, self._powers.approve(faults[0].id)
        return self._restart(wish, asked)

    def _restart(self, wish: Restart, asked: Asked) -> tuple[Result, str]:
        containers = self._settings.containers
        if wish.place > len(containers):
            return Result.FAILED, f"there is no container {wish.place}: {len(containers)} are configured"
        return Result.ACCEPTED, self._powers.restart(containers[wish.place - 1].key, asked.sender)

    def _look(self) -> tuple[Result, str]:
        now = self._clock.mono()
        if now - self._looked < CHECK_EVERY_S:
            return Result.TEMPORARILY_REJECTED, f"checks were asked for less than {CHECK_EVERY_S:g} s ago"
        self._looked = now
        self._powers.look()
        return Result.ACCEPTED, "all checks run now"

    def _details(self, number: int, asked: Asked) -> tuple[Result, str]:
        open_now = self._powers.open_faults()
        if number:
            found: Sequence[Fault] = _numbered((*self._powers.recent_faults(), *open_now), number)
        else:
            found = sorted(open_now, key=lambda fault: fault.opened.mono)
        if not found:
            return Result.FAILED, f"fault {number} is not known" if number else "no fault is open"
        others = [fault.id for fault in open_now if fault.id != found[-1].id]
        for part, message in enumerate(responses.details(found[-1], asked, others)):
            key = f"detail {asked.sender} {found[-1].id} {part}"
            self._port.send(message, Class.REQUEST, key=key, urgency=2, link=asked.link)
        return Result.ACCEPTED, f"details of {found[-1].id} are sent"

    # ------------------------------------------------------------ status, once or again and again

    def _send(self, message: int, link: str) -> tuple[Result, str]:
        if not self._powers.alive():
            return Result.FAILED, "PHM's checks have stalled: what it would say is old"
        now = self._clock.mono()
        if message == HEARTBEAT:
            if now - self._beat < HEARTBEAT_EVERY_S:
                return Result.TEMPORARILY_REJECTED, f"a heartbeat was asked for less than {HEARTBEAT_EVERY_S:g} s ago"
            self._beat = now
        built = responses.status(
            message,
            self._settings.agent.id,
            self._powers.states(),
            complete=self._powers.complete(),
            mono=now,
            utc=self._clock.utc(),
        )
        self._port.send(built, Class.REQUEST, key=f"asked {message}", urgency=1, link=link)
        return Result.ACCEPTED, f"message {message} is sent"

    def _keep_sending(self, wish: Repeat, asked: Asked) -> tuple[Result, str]:
        key = (asked.link, wish.message)
        self._repeats.pop(key, None)
        if wish.every_s == 0:
            return Result.ACCEPTED, f"message {wish.message} is no longer sent"
        if len(self._repeats) >= MAX_REPEATS:
            return Result.TEMPORARILY_REJECTED, "too many messages are sent again and again"
        self._repeats[key] = (wish.every_s, self._clock.mono(), asked)
        return Result.ACCEPTED, f"message {wish.message} is sent every {wish.every_s:g} s"

    def _repeat(self) -> float:
        now = self._clock.mono()
        for (link, message), (every_s, due, asked) in list(self._repeats.items()):
            if now < due:
                continue
            self._repeats[link, message] = (every_s, now + every_s, asked)
            if message == command.TUNNEL:
                self._details(0, asked)
            else:
                self._send(message, link)
        return max(0.0, min([IDLE_S, *(due - now for _every_s, due, _asked in self._repeats.values())]))


def _numbered(faults: Iterable[Fault], number: int) -> list[Fault]:
    return [fault for fault in faults if command.number(fault.id) == number]


def _shown(asked: Asked, verdict: Do | Refuse) -> str:
    return str(verdict.wish) if isinstance(verdict, Do) else f"command {asked.command} {asked.params}"
