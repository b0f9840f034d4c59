"""How much may be command, and what was command before. Bounded, whoever asks: senders can make up their numbers."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.rate_limiter import RateLimiter
from phm.wire.command import Command, CommandResult

SENDER_BURST, SENDER_RATE = 10.0, 2.0
"""Of one sender on one link: commands at once, and commands a second."""
ALL_BURST, ALL_RATE = 40.0, 10.0
"""Of all senders that do not sign together; and of all that do, who therefore cannot be crowded out by the others."""
MAX_SENDERS = 64
REPEAT_S = 30.0
"""A command that comes again with `confirmation` above 0 within this time is the same command."""
COPY_S = 5.0
"""The very same frame within this time is a copy that came by another way."""
MAX_DONE = 64


class CommandRateLimiter:
    """Not thread-safe: the caller's lock."""

    def __init__(self) -> None:
        self._senders = RateLimiter(SENDER_RATE, SENDER_BURST, MAX_SENDERS)
        self._all = RateLimiter(ALL_RATE, ALL_BURST, 2)

    def allow(self, link: str, system: int, component: int, signed: bool, now: float) -> bool:
        """Whether one more command is taken at `now` (monotonic seconds)."""
        # Both, in this order: a sender over its own limit takes nothing from the others.
        return self._senders.allow(now, (link, system, component, signed)) and self._all.allow(now, signed)


@dataclass(frozen=True, slots=True)
class _Done:
    at: float
    result: CommandResult
    frame: bytes


class CommandDedup:
    """What was done lately, so that it is not done twice. Signed commands have a memory of their own, so that no flood of others
    makes it forget one."""

    def __init__(self) -> None:
        self._done: dict[bool, DuplicateFilter[tuple[object, ...], _Done]] = {
            signed: DuplicateFilter(MAX_DONE, REPEAT_S) for signed in (True, False)
        }

    def before(self, command: Command, frame: bytes, now: float) -> CommandResult | None:
        """The result of the same command when this is it again, else None."""
        done = self._done[command.signed].get(_key(command), now)
        if done is None:
            return None
        copy = frame == done.frame and now - done.at <= COPY_S
        return done.result if command.confirmation > 0 or copy else None

    def did(self, command: Command, frame: bytes, result: CommandResult, now: float) -> None:
        self._done[command.signed].add(_key(command), _Done(now, result, frame), now)


def _key(command: Command) -> tuple[object, ...]:
    # Not the link: a ground station may ask again by another one.
    params = tuple(repr(value) for value in command.params)  # NaN equals nothing, its words do
    return command.system, command.component, command.command, params
