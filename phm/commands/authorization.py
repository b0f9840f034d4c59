"""Whether a command is answered at all, and whether it may be done. Pure: no message, no clock."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from phm.wire.command import (
    READ_ONLY,
    Command,
    CommandResult,
    InvalidParameters,
    Permission,
    Request,
    UnknownCommand,
    parse,
    required_permission,
)


@dataclass(frozen=True, slots=True)
class Accept:
    """It may be done."""

    request: Request


@dataclass(frozen=True, slots=True)
class Deny:
    """It is not done, and the asker is told so."""

    result: CommandResult
    why: str


@dataclass(frozen=True, slots=True)
class Ignore:
    """It is none of our business: no answer."""


Authorization = Accept | Deny | Ignore


def is_addressed_to(target_system: int, target_component: int, system: int, component: int) -> bool:
    """To us alone, or to all components of our system. What is for all systems is not: nothing here is for a swarm."""
    return target_system == system and target_component in (0, component)


def authorize(
    command: Command, allowed: Collection[str], *, signing: bool, command_age_s: float = 10.0
) -> Authorization:
    """signing: on, so that only a signed command is obeyed, and only for so long."""
    try:
        request: Request | None = parse(command.command, command.params)
        wrong = ""
    except UnknownCommand as error:
        if command.whole:
            return Ignore()  # another component's; an answer of ours would be taken for the vehicle's
        return Deny(CommandResult.UNSUPPORTED, f"{error} is not known here")
    except InvalidParameters as error:
        request, wrong = None, str(error)
    if command.whole and (request is None or required_permission(request) not in READ_ONLY):
        # MAV_CMD_USER_1 to all components means something else to an autopilot's scripts.
        return Ignore()
    if signing and not command.signed:
        return Deny(CommandResult.DENIED, "it is not signed")
    if signing and command.age_s > command_age_s:
        return Deny(
            CommandResult.DENIED,
            f"it was signed {command.age_s:.0f} s ago by the newest time known here, allowed are {command_age_s:g} s "
            "(mavlink.signing.command_age): it was recorded, or the clock of its sender is behind",
        )
    if request is None:
        return Deny(CommandResult.DENIED, wrong)
    needed: Permission = required_permission(request)
    if needed.value not in allowed:
        return Deny(CommandResult.DENIED, f"{needed.value!r} is not among mavlink.commands")
    return Accept(request)
