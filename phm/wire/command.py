"""Commands from the ground as data: which COMMAND_LONG and COMMAND_INT mean something here, and what. Pure.

The contract, for whoever writes a ground station (`docs/reference/mavlink.md`, Commands)::

    MAV_CMD_REQUEST_MESSAGE (512)        param1 the message's number
        0    HEARTBEAT, with the status word
        253  STATUSTEXT: the status line, which has the array
        390  ONBOARD_COMPUTER_STATUS
        385  TUNNEL: the text about the fault with number param2; 0 or none: the newest open fault
    MAV_CMD_SET_MESSAGE_INTERVAL (511)   param1 253, 390 or 385 (the newest open fault), param2 microseconds; -1 and 0: off
    MAV_CMD_USER_1 (31010)               param1 the operation
        1    run all checks now
        2    approve what is advised for the fault with number param2
        3    restart the container with place param2 in the configuration, from 1

A fault's number is what stands behind the dash of its id: 17 of ``ab12-17``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

COMMAND_INT, COMMAND_LONG, COMMAND_ACK = 75, 76, 77
HEARTBEAT, STATUSTEXT, TUNNEL, ONBOARD_COMPUTER_STATUS = 0, 253, 385, 390
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, USER_1 = 511, 512, 31010
CHECK, APPROVE, RESTART = 1, 2, 3
SHORTEST_S = {STATUSTEXT: 2.0, ONBOARD_COMPUTER_STATUS: 5.0, TUNNEL: 10.0}
"""Messages that may be asked for again and again, and how often at most."""
LARGEST = 2**24
"""Up to here a float of 32 bits holds every whole number."""


class CommandResult(IntEnum):
    """The part of MAV_RESULT that is used."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Permission(str, Enum):
    """What the configuration allows one by one (`mavlink.commands`). The first two only read."""

    STATUS = "status"
    DETAILS = "details"
    CHECK = "check"
    APPROVE = "approve"
    RESTART = "restart"


READ_ONLY = frozenset((Permission.STATUS, Permission.DETAILS))


@dataclass(frozen=True, slots=True)
class Command:
    """One command as it came. `whole`: addressed to all components of this system and not to this one alone. `age_s`: how long
    ago it was signed, seconds."""

    command: int
    params: tuple[float, float]
    confirmation: int
    system: int
    component: int
    link: str
    signed: bool
    whole: bool = False
    age_s: float = 0.0

    @property
    def sender(self) -> str:
        """``255/190``."""
        return f"{self.system}/{self.component}"


@dataclass(frozen=True, slots=True)
class SendMessage:
    """One message, now."""

    message: int


@dataclass(frozen=True, slots=True)
class SendDetails:
    """The text about a fault; `fault` is its number, 0 for the newest open one."""

    fault: int


@dataclass(frozen=True, slots=True)
class RepeatMessage:
    """A message again and again, `every_s` seconds apart; 0: no more."""

    message: int
    every_s: float


@dataclass(frozen=True, slots=True)
class RunChecks:
    """Run all checks now."""


@dataclass(frozen=True, slots=True)
class ApproveAction:
    """Say yes to what is advised for this fault."""

    fault: int


@dataclass(frozen=True, slots=True)
class RestartContainer:
    """Restart a container, by its place in the configuration, from 1."""

    place: int


Request = SendMessage | SendDetails | RepeatMessage | RunChecks | ApproveAction | RestartContainer


class UnknownCommand(Exception):
    """The command means nothing here: another component's, or a newer PHM's."""


class InvalidParameters(Exception):
    """The command is known and its parameters are not allowed; the message says which."""


def parse(command: int, params: tuple[float, float]) -> Request:
    """What is wished. params: param1 and param2. Raises Unknown and Wrong."""
    if command not in (REQUEST_MESSAGE, SET_MESSAGE_INTERVAL, USER_1):
        raise UnknownCommand(f"command {command}")
    what = _whole(params[0], "param1")
    if command == REQUEST_MESSAGE:
        return _message(what, params[1])
    return _repeat(what, params[1]) if command == SET_MESSAGE_INTERVAL else _operation(what, params[1])


def required_permission(request: Request) -> Permission:
    """What must be allowed for it."""
    if isinstance(request, (SendMessage, RepeatMessage)):
        return Permission.DETAILS if request.message == TUNNEL else Permission.STATUS
    words: dict[type, Permission] = {
        SendDetails: Permission.DETAILS,
        RunChecks: Permission.CHECK,
        ApproveAction: Permission.APPROVE,
        RestartContainer: Permission.RESTART,
    }
    return words[type(request)]


def fault_number(fault_id: str) -> int | None:
    """The number of a fault by its id, None when the id has none."""
    digits = fault_id.rpartition("-")[2]
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 10 else None


def _message(what: int, second: float) -> Request:
    if what == TUNNEL:
        # NaN is what a ground station puts into a parameter that it does not use.
        return SendDetails(0 if math.isnan(second) else _whole(second, "param2"))
    if what in (HEARTBEAT, STATUSTEXT, ONBOARD_COMPUTER_STATUS):
        return SendMessage(what)
    raise UnknownCommand(f"message {what}")


def _repeat(what: int, interval_us: float) -> Request:
    if what not in SHORTEST_S:
        raise UnknownCommand(f"the interval of message {what}")
    if interval_us in (-1.0, 0.0):
        return RepeatMessage(what, 0.0)
    if not SHORTEST_S[what] * 1e6 <= interval_us <= 3600e6:  # NaN is not, either
        raise InvalidParameters(f"param2 must be -1, 0 or {SHORTEST_S[what]:g} s to 1 h in microseconds")
    return RepeatMessage(what, interval_us / 1e6)


def _operation(what: int, second: float) -> Request:
    if what == CHECK:
        return RunChecks()
    if what not in (APPROVE, RESTART):
        raise UnknownCommand(f"operation {what}")
    chosen = _whole(second, "param2")
    if chosen == 0:
        raise InvalidParameters("param2 must be 1 or more")
    return ApproveAction(chosen) if what == APPROVE else RestartContainer(chosen)


def _whole(value: float, name: str) -> int:
    if not (0 <= value <= LARGEST and value == int(value)):  # NaN and infinity fail the first half
        raise InvalidParameters(f"{name} must be a whole number from 0 to {LARGEST}")
    return int(value)
