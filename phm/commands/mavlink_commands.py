"""Receives operator requests as MAVLink commands, has them authorized and executed, and acknowledges each to its sender.

A command passes these steps: addressed to PHM, known, signed, allowed, well-formed (`authorize`), within the rate limits
(`CommandRateLimiter`), not a repetition (`CommandDedup`). The endpoints' threads authorize and queue; a separate thread does the rest.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from typing import Any

from phm.commands import responses
from phm.commands.authorization import Accept, Deny, Ignore, authorize, is_addressed_to
from phm.commands.command_log import CommandLog
from phm.commands.handler import CommandHandler, numbered
from phm.commands.rate_limit import CommandDedup, CommandRateLimiter
from phm.commands.requests import Reply
from phm.commands.services import CommandServices, MavlinkPort
from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.model import Fault
from phm.core.settings import MavlinkSettings
from phm.transport.priority import UNSIGNED_LAST, MessagePriority, default_periods
from phm.wire.command import (
    COMMAND_INT,
    COMMAND_LONG,
    CONTAINERS_TEXT,
    HEARTBEAT,
    NAMED_VALUE_FLOAT,
    READ_ONLY,
    REPLY_TEXT,
    TUNNEL,
    USER_1,
    ApproveAction,
    Command,
    CommandResult,
    PlaceRequest,
    RepeatMessage,
    Request,
    SendContainers,
    SendDetails,
    SendMessage,
    describe,
    requested_key,
    required_permission,
)

logger = logging.getLogger(__name__)

KIND = "COMMAND"
MAX_WAITING = 64
"""Of signed and of unsigned commands each, so that unsigned ones cannot keep signed ones out."""
MAX_REPEATS = 64
IDLE_S = 1.0
CLOSING_S = 2.0


class MavlinkCommands:
    """`listen` queues what arrives, `start` also begins to answer. agent: the agent's id."""

    def __init__(
        self,
        port: MavlinkPort,
        handler: CommandHandler,
        services: CommandServices,
        settings: MavlinkSettings,
        agent: int,
        clock: Clock,
    ) -> None:
        self._port, self._handler, self._services, self._agent, self._clock = port, handler, services, agent, clock
        self._allowed, self._command_age_s = frozenset(settings.commands), settings.signing.command_age
        self._rate_limiter, self._dedup = CommandRateLimiter(), CommandDedup()
        self._waiting: dict[bool, BoundedQueue[tuple[Command, bytes, Accept | Deny]]] = {
            signed: BoundedQueue(clock, MAX_WAITING, refuse_new=True) for signed in (True, False)
        }
        """Signed ones, which are answered first, and others."""
        self._log = CommandLog()
        self._repeats: dict[tuple[str, int], tuple[float, float, Command]] = {}
        """By link and message: interval in seconds, when it is due, and the command that requested it."""
        self._heartbeat_s, self._heartbeat_at = settings.heartbeat, dict[str, float]()
        """By link, when a HEARTBEAT was sent on request."""
        self._lock = threading.Lock()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-commands", daemon=True)

    def resume(self, before: MavlinkCommands) -> None:
        """Go on as the predecessor on the same links (after a reload), before `start`: a repeated command is not executed again, and
        requested messages continue."""
        self._rate_limiter, self._dedup, self._log = before._rate_limiter, before._dedup, before._log
        self._repeats, self._heartbeat_at = before._repeats, before._heartbeat_at

    def start(self) -> None:
        self.listen()
        threads.start(self._thread)

    def listen(self) -> None:
        """Queue the messages that arrive from now on."""
        self._port.listen(self.receive, (COMMAND_LONG, COMMAND_INT))

    def close(self) -> None:
        """End the thread; waits at most CLOSING_S."""
        self._stop.set()
        self._wake.set()
        threads.join(self._thread, CLOSING_S)

    # ------------------------------------------------------------ the endpoints' threads

    def receive(self, message: Any, link: str) -> None:
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
            broadcast=message.target_component == 0,
            age_s=getattr(message, "_age_s", 0.0),
            name_hash=message.param3,
            for_s=message.param4,
            rest=_rest(message),
        )
        authorization = authorize(command, self._allowed, signing=self._port.signs, command_age_s=self._command_age_s)
        if isinstance(authorization, Ignore):
            return
        with self._lock:
            allowed = self._rate_limiter.allow(link, *sender, command.signed, self._clock.mono())
            item = (command, bytes(message.get_msgbuf()), authorization)
            if not allowed or not self._waiting[command.signed].put(item):
                self._log.count_dropped()
                return
        self._wake.set()

    # ------------------------------------------------------------ the commands' thread

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._wake.clear()
            try:
                wait_s = self.tick()
            except Exception:  # one command must not keep the others from an answer
                logger.exception("handling a command failed")
                wait_s = IDLE_S
            self._clock.wait(self._wake, wait_s)

    def tick(self) -> float:
        """Answer the queued commands and send the messages that are due; seconds until the next is due."""
        while not self._stop.is_set():
            waiting = self._waiting[True].next() or self._waiting[False].next()
            if waiting is None:
                break
            self._answer(*waiting)
        with self._lock:
            lines = self._log.summary(self._clock.mono())
        for line in lines:
            self._services.note(KIND, line)
        return self._send_due()

    def _answer(self, command: Command, frame: bytes, authorization: Accept | Deny) -> None:
        now = self._clock.mono()
        previous = self._dedup.previous_result(command, frame, now)
        if previous is not None:
            self._acknowledge(command, previous)
            return
        if isinstance(authorization, Deny):
            reply, acts = Reply(authorization.result, authorization.why), False
            what = f"command {command.command} {command.params}"
        else:
            request = authorization.request
            reply, acts = self._execute(request, command), isinstance(request, (ApproveAction, PlaceRequest))
            what = describe(request)
        self._dedup.record(command, frame, reply.result, now)
        self._acknowledge(command, reply.result)
        if command.command == USER_1 and (command.signed or not self._port.signs):
            self._send_text(REPLY_TEXT, responses.text(REPLY_TEXT, reply.text, command), command)
        with self._lock:
            logged = self._log.should_log(command, reply.result, now, acts=acts)
        if logged:
            signed = "signed" if command.signed else "unsigned"
            result = reply.result.name.lower().replace("_", " ")
            self._services.note(
                KIND, f"{result}: {what} from {command.sender} by {command.link}, {signed}: {reply.text}"
            )

    def _urgency(self, command: Command, usual: int) -> int:
        """Where a link has room for few answers, those to unsigned senders, whose ids may be forged, are sent last."""
        return UNSIGNED_LAST if self._port.signs and not command.signed else usual

    def _send_text(self, about: str, messages: Sequence[Any], command: Command) -> None:
        urgency = self._urgency(command, 2)
        for part, message in enumerate(messages):
            key = f"detail {command.sender} {about} {part}"
            self._port.send(message, MessagePriority.REQUEST, key=key, urgency=urgency, link=command.link)

    def _acknowledge(self, command: Command, result: CommandResult) -> None:
        urgency = self._urgency(command, 0)
        key = f"ack {command.sender} {command.command} {command.signed}"
        self._port.send(
            responses.ack(command, result), MessagePriority.REQUEST, key=key, urgency=urgency, link=command.link
        )

    def _execute(self, request: Request, command: Command) -> Reply:
        try:
            if command.signed and required_permission(request) not in READ_ONLY:
                if problem := self._services.clock_problem():
                    return Reply(CommandResult.TEMPORARILY_REJECTED, problem)
                try:
                    self._services.remember()
                except TimeoutError as error:
                    return Reply(CommandResult.TEMPORARILY_REJECTED, str(error))
            match request:
                case SendMessage(message):
                    return self._send(message, command.link)
                case SendDetails(fault):
                    return self._send_details(fault, command)
                case SendContainers():
                    return self._send_containers(command)
                case RepeatMessage():
                    return self._repeat(request, command)
                case _:
                    return self._handler.execute(request, command.sender)
        except BaseException as error:  # as in `CommandHandler.execute`
            return Reply(CommandResult.FAILED, str(error) or type(error).__name__)

    # ------------------------------------------------------------ status and details

    def _send_details(self, number: int, command: Command) -> Reply:
        open_now = self._services.open_faults()
        if number:
            found: Sequence[Fault] = numbered((*self._services.recent_faults(), *open_now), number)
        else:
            found = sorted(open_now, key=lambda fault: fault.opened.mono)
        if not found:
            return Reply(CommandResult.FAILED, f"fault {number} is unknown" if number else "no fault is open")
        others = [fault.id for fault in open_now if fault.id != found[-1].id]
        self._send_text(found[-1].id, responses.details(found[-1], command, others), command)
        return Reply(CommandResult.ACCEPTED, f"sending details of {found[-1].id}")

    def _send_containers(self, command: Command) -> Reply:
        if not self._handler.containers:
            return Reply(CommandResult.FAILED, "no container is configured")
        self._send_text(CONTAINERS_TEXT, responses.containers(self._handler.containers, command), command)
        return Reply(CommandResult.ACCEPTED, "sending the list of containers")

    def _send(self, message: int, link: str) -> Reply:
        if not self._services.alive():
            return Reply(CommandResult.FAILED, "PHM's checks have stalled, so its status is out of date")
        now = self._clock.mono()
        if message == HEARTBEAT:
            # The budget of a link does not limit HEARTBEATs, so requests at most double them.
            every_s = self._heartbeat_s or default_periods(self._port.agents)[0]
            if now - self._heartbeat_at.get(link, float("-inf")) < every_s:
                return Reply(
                    CommandResult.TEMPORARILY_REJECTED, f"a heartbeat was requested less than {every_s:g} s ago"
                )
            self._heartbeat_at[link] = now
        if message == NAMED_VALUE_FLOAT:
            return self._send_rates(link, now)
        built = responses.status(
            message,
            self._agent,
            self._services.states(),
            complete=self._services.complete(),
            mono=now,
            utc=self._clock.utc(),
        )
        self._port.send(built, MessagePriority.REQUEST, key=requested_key(message), urgency=1, link=link)
        return Reply(CommandResult.ACCEPTED, f"sending message {message}")

    def _send_rates(self, link: str, now: float) -> Reply:
        built = responses.rates(self._services.states(), mono=now)
        if not built:
            return Reply(CommandResult.FAILED, "no rate of a topic is measured")
        for place, message in enumerate(built):
            self._port.send(message, MessagePriority.REQUEST, key=f"requested rate {place}", urgency=1, link=link)
        return Reply(CommandResult.ACCEPTED, f"sending the rates of {len(built)} topics")

    def _repeat(self, request: RepeatMessage, command: Command) -> Reply:
        key = (command.link, request.message)
        self._repeats.pop(key, None)
        if request.every_s == 0:
            return Reply(CommandResult.ACCEPTED, f"message {request.message} is no longer repeated")
        if len(self._repeats) >= MAX_REPEATS:
            return Reply(CommandResult.TEMPORARILY_REJECTED, f"at most {MAX_REPEATS} messages can be repeated")
        self._repeats[key] = (request.every_s, self._clock.mono(), command)
        return Reply(CommandResult.ACCEPTED, f"sending message {request.message} every {request.every_s:g} s")

    def _send_due(self) -> float:
        """Send the repeated messages that are due; seconds until the next is due."""
        now = self._clock.mono()
        for (link, message), (every_s, due, command) in list(self._repeats.items()):
            if now < due:
                continue
            self._repeats[link, message] = (every_s, now + every_s, command)
            if message == TUNNEL:
                self._send_details(0, command)
            else:
                self._send(message, link)
        return max(0.0, min([IDLE_S, *(due - now for _every_s, due, _command in self._repeats.values())]))


def _rest(message: Any) -> tuple[float, float, float]:
    """param5 to param7; COMMAND_INT calls them by what they are in navigation commands."""
    if message.get_msgId() == COMMAND_INT:
        return message.x, message.y, message.z
    return message.param5, message.param6, message.param7
