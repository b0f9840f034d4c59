"""Limits the rate of MAVLink commands and detects repeated ones. Memory is bounded, because senders can forge their ids."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.rate_limiter import RateLimiter
from phm.wire.command import Command, CommandResult

SENDER_BURST, SENDER_RATE = 10.0, 2.0
"""Of one sender on one link: commands in a burst, and commands a second."""
ALL_BURST, ALL_RATE = 40.0, 10.0
"""Of all unsigned commands together, and of all signed ones, which others cannot displace."""
MAX_SENDERS = 64
REPEAT_S = 30.0
"""A command with `confirmation` above 0 within this time of an equal one is a repetition of it."""
COPY_S = 5.0
"""An identical frame within this time is a copy that took another route."""
MAX_DONE = 64


class CommandRateLimiter:
    """Limits the rate of commands. Not thread-safe."""

    def __init__(self) -> None:
        self._senders = RateLimiter(SENDER_RATE, SENDER_BURST, MAX_SENDERS)
        self._all = RateLimiter(ALL_RATE, ALL_BURST, 2)

    def allow(self, link: str, system: int, component: int, signed: bool, now: float) -> bool:
        """Whether one more command is accepted at `now` (monotonic seconds)."""
        # Both, in this order: a sender over its own limit takes nothing from the others.
        return self._senders.allow(now, (link, system, component, signed)) and self._all.allow(now, signed)


@dataclass(frozen=True, slots=True)
class _Done:
    at: float
    result: CommandResult
    frame: bytes


class CommandDedup:
    """Remembers the results of recent commands, so that none is executed twice. Signed and unsigned ones are kept apart, so that
    unsigned ones cannot displace signed ones."""

    def __init__(self) -> None:
        self._done: dict[bool, DuplicateFilter[tuple[object, ...], _Done]] = {
            signed: DuplicateFilter(MAX_DONE, REPEAT_S) for signed in (True, False)
        }

    def previous_result(self, command: Command, frame: bytes, now: float) -> CommandResult | None:
        """The result of the command that this one repeats, None when it is a new one."""
        done = self._done[command.signed].get(_key(command), now)
        if done is None:
            return None
        copy = frame == done.frame and now - done.at <= COPY_S
        return done.result if command.confirmation > 0 or copy else None

    def record(self, command: Command, frame: bytes, result: CommandResult, now: float) -> None:
        self._done[command.signed].add(_key(command), _Done(now, result, frame), now)


def _key(command: Command) -> tuple[object, ...]:
    # Without the link: a ground station may repeat a command on another one.
    params = tuple(
        repr(value) for value in (*command.params, command.name_hash, command.for_s, *command.rest)
    )  # as text, because NaN is not equal to itself
    return command.system, command.component, command.command, params
