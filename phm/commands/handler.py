"""Takes commands from the links, has them judged, carries them out and acknowledges each to its asker.

A command passes: addressed to us? known? signed, allowed, well-formed (`authorize`)? not too many (`CommandRateLimiter`)? not done before
(`CommandDedup`)? Only then is anything done. The endpoints' threads judge and queue; the rest is the desk's own thread.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Sequence
from typing import Any

from phm.commands import responses
from phm.commands.authorization import Accept, Deny, Ignore, authorize, is_addressed_to
from phm.commands.command_log import CommandLog
from phm.commands.rate_limit import CommandDedup, CommandRateLimiter
from phm.commands.services import CommandServices, MavlinkPort
from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.model import Fault
from phm.core.settings import Settings
from phm.transport.priority import MessagePriority
from phm.wire.command import (
    COMMAND_INT,
    COMMAND_LONG,
    HEARTBEAT,
    READ_ONLY,
    TUNNEL,
    ApproveAction,
    Command,
    CommandResult,
    RepeatMessage,
    Request,
    RestartContainer,
    RunChecks,
    SendDetails,
    SendMessage,
    fault_number,
    required_permission,
)

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


class CommandHandler:
    """See the module."""

    def __init__(self, port: MavlinkPort, services: CommandServices, settings: Settings, clock: Clock) -> None:
        self._port, self._services, self._settings, self._clock = port, services, settings, clock
        self._allowed = frozenset(settings.mavlink.commands)
        self._rate_limiter, self._dedup = CommandRateLimiter(), CommandDedup()
        self._waiting: dict[bool, BoundedQueue[tuple[Command, bytes, Accept | Deny]]] = {
            signed: BoundedQueue(clock, MAX_WAITING, refuse_new=True) for signed in (True, False)
        }
        """Signed ones, which are answered first, and others."""
        self._log = CommandLog()
        self._repeats: dict[tuple[str, int], tuple[float, float, Command]] = {}
        """By link and message: seconds between, when it is due, and whose."""
        self._looked = self._beat = float("-inf")
        self._lock = threading.Lock()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-commands", daemon=True)

    def start(self) -> None:
        self.listen()
        threads.start(self._thread)

    def listen(self) -> None:
        """Queue what arrives from now on."""
        self._port.listen(self.hear, (COMMAND_LONG, COMMAND_INT))

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
        if sender == ours or not is_addressed_to(message.target_system, message.target_component, *ours):
            return
        command = Command(
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
        authorization = authorize(command, self._allowed, signing=self._port.signs, command_age_s=limit_s)
        if isinstance(authorization, Ignore):
            return
        with self._lock:
            allowed = self._rate_limiter.allow(link, *sender, command.signed, self._clock.mono())
            item = (command, bytes(message.get_msgbuf()), authorization)
            if not allowed or not self._waiting[command.signed].put(item):
                self._log.dropped()
                return
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
            waiting = self._waiting[True].next() or self._waiting[False].next()
            if waiting is None:
                break
            self._answer(*waiting)
        with self._lock:
            lines = self._log.due(self._clock.mono())
        for line in lines:
            self._services.note(KIND, line)
        return self._repeat()

    def _answer(self, command: Command, frame: bytes, authorization: Accept | Deny) -> None:
        now = self._clock.mono()
        before = self._dedup.before(command, frame, now)
        if before is not None:
            self._acknowledge(command, before)
            return
        if isinstance(authorization, Deny):
            result, words = authorization.result, authorization.why
        else:
            result, words = self._carry_out(authorization.request, command)
        self._dedup.did(command, frame, result, now)
        self._acknowledge(command, result)
        acts = isinstance(authorization, Accept) and isinstance(
            authorization.request, (ApproveAction, RestartContainer)
        )
        with self._lock:
            logs = self._log.logs(command, result, now, acts=acts)
        if logs:
            signed = "signed" if command.signed else "unsigned"
            shown = f"{result.name.lower()}: {_shown(command, authorization)}"
            self._services.note(KIND, f"{shown} from {command.sender} by {command.link}, {signed}: {words}")

    def _acknowledge(self, command: Command, result: CommandResult) -> None:
        # Where the link has room for few answers, those to senders that anybody can make up come last.
        urgency = UNSIGNED_LAST if self._port.signs and not command.signed else 0
        key = f"ack {command.sender} {command.command} {command.signed}"
        self._port.send(
            responses.ack(command, result), MessagePriority.REQUEST, key=key, urgency=urgency, link=command.link
        )

    def _carry_out(self, request: Request, command: Command) -> tuple[CommandResult, str]:
        """Do it; the result and what to note. Whatever goes wrong is FAILED, with the reason."""
        try:
            if command.signed and required_permission(request) not in READ_ONLY:
                if problem := self._services.clock_problem():
                    return CommandResult.TEMPORARILY_REJECTED, problem
                self._services.remember()
            return self._do(request, command)
        except self._services.later as error:
            return CommandResult.TEMPORARILY_REJECTED, str(error)
        except Exception as error:
            return CommandResult.FAILED, str(error) or type(error).__name__

    def _do(self, request: Request, command: Command) -> tuple[CommandResult, str]:
        if isinstance(request, SendMessage):
            return self._send(request.message, command.link)
        if isinstance(request, SendDetails):
            return self._details(request.fault, command)
        if isinstance(request, RepeatMessage):
            return self._keep_sending(request, command)
        if isinstance(request, RunChecks):
            return self._look()
        if isinstance(request, ApproveAction):
            faults = _numbered(self._services.open_faults(), request.fault)
            if len(faults) != 1:
                return (
                    CommandResult.FAILED,
                    f"{'no' if not faults else 'more than one'} open fault has number {request.fault}",
                )
            return CommandResult.ACCEPTED, self._services.approve(faults[0].id)
        return self._restart(request, command)

    def _restart(self, request: RestartContainer, command: Command) -> tuple[CommandResult, str]:
        containers = self._settings.containers
        if request.place > len(containers):
            return CommandResult.FAILED, f"there is no container {request.place}: {len(containers)} are configured"
        return CommandResult.ACCEPTED, self._services.restart(containers[request.place - 1].key, command.sender)

    def _look(self) -> tuple[CommandResult, str]:
        now = self._clock.mono()
        if now - self._looked < CHECK_EVERY_S:
            return CommandResult.TEMPORARILY_REJECTED, f"checks were asked for less than {CHECK_EVERY_S:g} s ago"
        self._looked = now
        self._services.look()
        return CommandResult.ACCEPTED, "all checks run now"

    def _details(self, number: int, command: Command) -> tuple[CommandResult, str]:
        open_now = self._services.open_faults()
        if number:
            found: Sequence[Fault] = _numbered((*self._services.recent_faults(), *open_now), number)
        else:
            found = sorted(open_now, key=lambda fault: fault.opened.mono)
        if not found:
            return CommandResult.FAILED, f"fault {number} is not known" if number else "no fault is open"
        others = [fault.id for fault in open_now if fault.id != found[-1].id]
        for part, message in enumerate(responses.details(found[-1], command, others)):
            key = f"detail {command.sender} {found[-1].id} {part}"
            self._port.send(message, MessagePriority.REQUEST, key=key, urgency=2, link=command.link)
        return CommandResult.ACCEPTED, f"details of {found[-1].id} are sent"

    # ------------------------------------------------------------ status, once or again and again

    def _send(self, message: int, link: str) -> tuple[CommandResult, str]:
        if not self._services.alive():
            return CommandResult.FAILED, "PHM's checks have stalled: what it would say is old"
        now = self._clock.mono()
        if message == HEARTBEAT:
            if now - self._beat < HEARTBEAT_EVERY_S:
                return (
                    CommandResult.TEMPORARILY_REJECTED,
                    f"a heartbeat was asked for less than {HEARTBEAT_EVERY_S:g} s ago",
                )
            self._beat = now
        built = responses.status(
            message,
            self._settings.agent.id,
            self._services.states(),
            complete=self._services.complete(),
            mono=now,
            utc=self._clock.utc(),
        )
        self._port.send(built, MessagePriority.REQUEST, key=f"asked {message}", urgency=1, link=link)
        return CommandResult.ACCEPTED, f"message {message} is sent"

    def _keep_sending(self, request: RepeatMessage, command: Command) -> tuple[CommandResult, str]:
        key = (command.link, request.message)
        self._repeats.pop(key, None)
        if request.every_s == 0:
            return CommandResult.ACCEPTED, f"message {request.message} is no longer sent"
        if len(self._repeats) >= MAX_REPEATS:
            return CommandResult.TEMPORARILY_REJECTED, "too many messages are sent again and again"
        self._repeats[key] = (request.every_s, self._clock.mono(), command)
        return CommandResult.ACCEPTED, f"message {request.message} is sent every {request.every_s:g} s"

    def _repeat(self) -> float:
        now = self._clock.mono()
        for (link, message), (every_s, due, command) in list(self._repeats.items()):
            if now < due:
                continue
            self._repeats[link, message] = (every_s, now + every_s, command)
            if message == TUNNEL:
                self._details(0, command)
            else:
                self._send(message, link)
        return max(0.0, min([IDLE_S, *(due - now for _every_s, due, _asked in self._repeats.values())]))


def _numbered(faults: Iterable[Fault], number: int) -> list[Fault]:
    return [fault for fault in faults if fault_number(fault.id) == number]


def _shown(command: Command, authorization: Accept | Deny) -> str:
    return (
        str(authorization.request)
        if isinstance(authorization, Accept)
        else f"command {command.command} {command.params}"
    )
