"""Decides who may request what: MAVLink commands by permission and signature, the control socket by user. Pure."""

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
    """The command is executed."""

    request: Request


@dataclass(frozen=True, slots=True)
class Deny:
    """It is refused, and the sender gets the result."""

    result: CommandResult
    why: str


@dataclass(frozen=True, slots=True)
class Ignore:
    """The command is not for PHM: it gets no answer."""


Authorization = Accept | Deny | Ignore


def is_addressed_to(target_system: int, target_component: int, system: int, component: int) -> bool:
    """Addressed to PHM, or to all components of its system. Commands to all systems are not accepted."""
    return target_system == system and target_component in (0, component)


def authorize(
    command: Command, allowed: Collection[str], *, signing: bool, command_age_s: float = 10.0
) -> Authorization:
    """allowed: `mavlink.commands`. signing: only signed commands are accepted, and only until `command_age_s` seconds after signing."""
    try:
        request: Request | None = parse(command.command, command.params, command.name_hash, command.for_s)
        wrong = ""
    except UnknownCommand as error:
        if command.broadcast:
            return Ignore()  # another component's; an answer would be taken for the vehicle's
        return Deny(CommandResult.UNSUPPORTED, f"{error} is not supported")
    except InvalidParameters as error:
        request, wrong = None, str(error)
    if command.broadcast and (request is None or required_permission(request) not in READ_ONLY):
        # To an autopilot's scripts, MAV_CMD_USER_1 means something else.
        return Ignore()
    if signing and not command.signed:
        return Deny(CommandResult.DENIED, "not signed")
    if signing and command.age_s > command_age_s:
        return Deny(
            CommandResult.DENIED,
            f"signed {command.age_s:.0f} s ago, at most {command_age_s:g} s are allowed (mavlink.signing.command_age): "
            "a replay, or the sender's clock is slow",
        )
    if request is None:
        return Deny(CommandResult.DENIED, wrong)
    needed: Permission = required_permission(request)
    if needed.value not in allowed:
        return Deny(CommandResult.DENIED, f"{needed.value!r} is not in mavlink.commands")
    return Accept(request)


def may_use_socket(uid: int, own_uid: int) -> bool:
    """Whether this user may use the control socket: root and PHM's own user."""
    return uid in (0, own_uid)
