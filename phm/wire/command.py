"""MAVLink commands as data: which COMMAND_LONG and COMMAND_INT PHM supports. Pure.

The contract for ground stations (`docs/reference/mavlink.md`, Commands)::

    MAV_CMD_REQUEST_MESSAGE (512)        param1 the message's number
        0    HEARTBEAT, with the status word
        253  STATUSTEXT: the status line, which has the array
        390  ONBOARD_COMPUTER_STATUS
        251  NAMED_VALUE_FLOAT: one for each topic with a measured rate, in Hz
        385  TUNNEL: the text about the fault with number param2; 0 or none: the newest open fault; -1: the containers
    MAV_CMD_SET_MESSAGE_INTERVAL (511)   param1 253, 390, 251 or 385 (the newest open fault), param2 microseconds; -1 and 0: off
    MAV_CMD_USER_1 (31010)               param1 the operation
        1    run all checks now
        2    approve the recommended action for the fault with number param2
        3    restart the container at position param2 in the configuration, from 1; param3 the hash of its name, 0 or NaN: not given
        4    hold the container at position param2; param3 as above; param4 seconds, 0 or NaN: the configured length
        5    release the container at position param2; param3 as above

A repetition (confirmation above 0) is one of a command with equal parameters. A ground station may send another number in param7
with each request, so that it is not taken for a repetition of an earlier one.
The answer to MAV_CMD_USER_1 is also sent as text, in a TUNNEL to the sender.
A fault's number is the part of its id after the dash: 17 of ``ab12-17``.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from enum import Enum, IntEnum

from phm.wire.text import one_line

COMMAND_INT, COMMAND_LONG, COMMAND_ACK = 75, 76, 77
HEARTBEAT, NAMED_VALUE_FLOAT, STATUSTEXT, TUNNEL, ONBOARD_COMPUTER_STATUS = 0, 251, 253, 385, 390
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, USER_1 = 511, 512, 31010
CHECK, APPROVE, RESTART, HOLD, RELEASE = 1, 2, 3, 4, 5
CONTAINERS = -1
"""param2 of a request for TUNNEL."""
CONTAINERS_TEXT, REPLY_TEXT = "containers", "reply"
"""Used instead of the id of a fault in the TUNNEL messages that carry other texts."""
SHORTEST_S = {STATUSTEXT: 2.0, ONBOARD_COMPUTER_STATUS: 5.0, NAMED_VALUE_FLOAT: 5.0, TUNNEL: 10.0}
"""Messages that can be repeated, with their shortest interval."""
LARGEST = 2**24
"""Up to here a 32-bit float represents every integer."""
MAX_NAME = 128
"""This many characters of a container's name count."""


class CommandResult(IntEnum):
    """The values of MAV_RESULT that PHM uses."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Permission(str, Enum):
    """What `mavlink.commands` allows individually. The first two only read."""

    STATUS = "status"
    DETAILS = "details"
    CHECK = "check"
    APPROVE = "approve"
    RESTART = "restart"
    HOLD = "hold"


READ_ONLY = frozenset((Permission.STATUS, Permission.DETAILS))


@dataclass(frozen=True, slots=True)
class Command:
    """One command as received. broadcast: addressed to all components of the system. age_s: seconds since it was signed.
    name_hash, for_s: param3 and param4 as received. rest: param5 to param7, which have no meaning, but make requests distinct."""

    command: int
    params: tuple[float, float]
    confirmation: int
    system: int
    component: int
    link: str
    signed: bool
    broadcast: bool = False
    age_s: float = 0.0
    name_hash: float = 0.0
    for_s: float = 0.0
    rest: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def sender(self) -> str:
        """``255/190``."""
        return f"{self.system}/{self.component}"


@dataclass(frozen=True, slots=True)
class SendMessage:
    """Send one message now."""

    message: int


@dataclass(frozen=True, slots=True)
class SendDetails:
    """Send the text about a fault. fault: its number, 0 for the newest open one."""

    fault: int


@dataclass(frozen=True, slots=True)
class SendContainers:
    """Send the names of the configured containers with their positions."""


@dataclass(frozen=True, slots=True)
class RepeatMessage:
    """Send a message every `every_s` seconds; 0: stop."""

    message: int
    every_s: float


@dataclass(frozen=True, slots=True)
class RunChecks:
    """Run all checks now."""


@dataclass(frozen=True, slots=True)
class ApproveAction:
    """Approve the recommended action. fault: its number (MAVLink) or its id (control socket)."""

    fault: int | str


@dataclass(frozen=True, slots=True)
class RestartContainer:
    """Restart a container. place: its position in the configuration, from 1. name_hash: `container_hash` of its name, 0: not given."""

    place: int
    name_hash: int = 0


@dataclass(frozen=True, slots=True)
class HoldContainerAt:
    """Keep recovery from the container at this position. for_s: seconds, None for the configured length."""

    place: int
    name_hash: int = 0
    for_s: float | None = None


@dataclass(frozen=True, slots=True)
class ReleaseContainerAt:
    """End the hold of the container at this position."""

    place: int
    name_hash: int = 0


PlaceRequest = RestartContainer | HoldContainerAt | ReleaseContainerAt
Request = SendMessage | SendDetails | SendContainers | RepeatMessage | RunChecks | ApproveAction | PlaceRequest


class UnknownCommand(Exception):
    """PHM does not support the command: it is another component's, or a newer PHM's."""


class InvalidParameters(Exception):
    """The command is supported, its parameters are not allowed; the message says which."""


def parse(command: int, params: tuple[float, float], name_hash: float = 0.0, for_s: float = 0.0) -> Request:
    """The request. params: param1 and param2. name_hash: param3. for_s: param4. Raises UnknownCommand and InvalidParameters."""
    if command not in (REQUEST_MESSAGE, SET_MESSAGE_INTERVAL, USER_1):
        raise UnknownCommand(f"command {command}")
    what = _whole(params[0], "param1")
    if command == REQUEST_MESSAGE:
        return _message(what, params[1])
    if command == SET_MESSAGE_INTERVAL:
        return _repeat(what, params[1])
    return _operation(what, params[1], name_hash, for_s)


def required_permission(request: Request) -> Permission:
    """The permission that a request needs."""
    if isinstance(request, (SendMessage, RepeatMessage)):
        return Permission.DETAILS if request.message == TUNNEL else Permission.STATUS
    words: dict[type, Permission] = {
        SendDetails: Permission.DETAILS,
        SendContainers: Permission.DETAILS,
        RunChecks: Permission.CHECK,
        ApproveAction: Permission.APPROVE,
        RestartContainer: Permission.RESTART,
        HoldContainerAt: Permission.HOLD,
        ReleaseContainerAt: Permission.HOLD,
    }
    return words[type(request)]


def describe(request: Request) -> str:
    """The command in words, for the log."""
    match request:
        case SendMessage(message):
            return f"send message {message}"
        case SendDetails(fault):
            return f"send details of {f'fault {fault}' if fault else 'the newest fault'}"
        case SendContainers():
            return "send the list of containers"
        case RepeatMessage(message, every_s):
            return f"send message {message} every {every_s:g} s" if every_s else f"stop repeating message {message}"
        case RunChecks():
            return "run all checks"
        case ApproveAction(fault):
            return f"approve the action for fault {fault}"
        case RestartContainer(place, _):
            return f"restart container {place}"
        case HoldContainerAt(place, _, for_s):
            return f"hold container {place}{f' for {for_s:g} s' if for_s else ''}"
        case ReleaseContainerAt(place, _):
            return f"release container {place}"


def requested_key(message: int) -> str:
    """The key with which a requested message waits for a link: a newer one with this key replaces it."""
    return f"requested {message}"


def fault_number(fault_id: str) -> int | None:
    """The number in a fault's id, None when it has none."""
    digits = fault_id.rpartition("-")[2]
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 10 else None


def container_hash(name: str) -> int:
    """A number from 1 to 2^24 - 1 for the name of a container as it is listed: it is exact in a 32-bit float."""
    return zlib.crc32(one_line(name)[:MAX_NAME].encode("utf-8", "replace")) % (LARGEST - 1) + 1


def _message(what: int, second: float) -> Request:
    if what == TUNNEL and second == CONTAINERS:
        return SendContainers()
    if what == TUNNEL:
        # Ground stations send NaN in a parameter that they do not use.
        return SendDetails(0 if math.isnan(second) else _whole(second, "param2"))
    if what in (HEARTBEAT, STATUSTEXT, ONBOARD_COMPUTER_STATUS, NAMED_VALUE_FLOAT):
        return SendMessage(what)
    raise UnknownCommand(f"message {what}")


def _repeat(what: int, interval_us: float) -> Request:
    if what not in SHORTEST_S:
        raise UnknownCommand(f"the interval of message {what}")
    if interval_us in (-1.0, 0.0):
        return RepeatMessage(what, 0.0)
    if not SHORTEST_S[what] * 1e6 <= interval_us <= 3600e6:  # False for NaN, too
        raise InvalidParameters(f"param2 must be -1, 0 or {SHORTEST_S[what]:g} s to 1 h in microseconds")
    return RepeatMessage(what, interval_us / 1e6)


def _operation(what: int, second: float, third: float, fourth: float) -> Request:
    if what == CHECK:
        return RunChecks()
    if what not in (APPROVE, RESTART, HOLD, RELEASE):
        raise UnknownCommand(f"operation {what}")
    chosen = _whole(second, "param2")
    if chosen == 0:
        raise InvalidParameters("param2 must be 1 or more")
    if what == APPROVE:
        return ApproveAction(chosen)
    # Ground stations that do not know this parameter send 0 or NaN.
    named = 0 if math.isnan(third) else _whole(third, "param3")
    if what == HOLD:
        return HoldContainerAt(chosen, named, None if math.isnan(fourth) else _whole(fourth, "param4") or None)
    return ReleaseContainerAt(chosen, named) if what == RELEASE else RestartContainer(chosen, named)


def _whole(value: float, name: str) -> int:
    if not (0 <= value <= LARGEST and value == int(value)):  # NaN and infinity fail the first half
        raise InvalidParameters(f"{name} must be an integer from 0 to {LARGEST}")
    return int(value)
