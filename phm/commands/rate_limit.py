"""How much may be command, and what was command before. Bounded, whoever asks: senders can make up their numbers."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

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


@dataclass(slots=True)
class _Bucket:
    credit: float
    at: float

    def take(self, now: float, burst: float, rate: float) -> bool:
        self.credit, self.at = min(burst, self.credit + max(0.0, now - self.at) * rate), now
        if self.credit < 1.0:
            return False
        self.credit -= 1.0
        return True


class CommandRateLimiter:
    """Not thread-safe: the caller's lock."""

    def __init__(self) -> None:
        self._senders: OrderedDict[tuple[str, int, int, bool], _Bucket] = OrderedDict()
        self._all: dict[bool, _Bucket] = {}

    def allow(self, link: str, system: int, component: int, signed: bool, now: float) -> bool:
        """Whether one more command is taken at `now` (monotonic seconds)."""
        key = (link, system, component, signed)
        mine = self._senders.pop(key, None) or _Bucket(SENDER_BURST, now)
        self._senders[key] = mine
        if len(self._senders) > MAX_SENDERS:
            self._senders.popitem(last=False)
        # Both, in this order: who is over his own limit takes nothing from the others.
        return mine.take(now, SENDER_BURST, SENDER_RATE) and self._all.setdefault(signed, _Bucket(ALL_BURST, now)).take(
            now, ALL_BURST, ALL_RATE
        )


@dataclass(frozen=True, slots=True)
class _Done:
    at: float
    result: CommandResult
    frame: bytes


class CommandDedup:
    """What was done lately, so that it is not done twice. Signed commands have a memory of their own, so that no flood of others
    makes it forget one."""

    def __init__(self) -> None:
        self._done: dict[bool, OrderedDict[tuple[object, ...], _Done]] = {True: OrderedDict(), False: OrderedDict()}

    def before(self, command: Command, frame: bytes, now: float) -> CommandResult | None:
        """The result of the same command when this is it again, else None."""
        done = self._done[command.signed].get(_key(command))
        if done is None:
            return None
        again = command.confirmation > 0 and now - done.at <= REPEAT_S
        copy = frame == done.frame and now - done.at <= COPY_S
        return done.result if again or copy else None

    def did(self, command: Command, frame: bytes, result: CommandResult, now: float) -> None:
        key, of_kind = _key(command), self._done[command.signed]
        of_kind.pop(key, None)
        of_kind[key] = _Done(now, result, frame)
        if len(of_kind) > MAX_DONE:
            of_kind.popitem(last=False)


def _key(command: Command) -> tuple[object, ...]:
    # Not the link: a ground station may ask again by another one.
    params = tuple(repr(value) for value in command.params)  # NaN equals nothing, its words do
    return command.system, command.component, command.command, params
