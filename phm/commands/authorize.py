"""Whether a command is answered at all, and whether it may be done. Pure: no message, no clock."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from phm.wire import command
from phm.wire.command import READS, Asked, Result, Unknown, Wish, Word, Wrong


@dataclass(frozen=True, slots=True)
class Do:
    """It may be done."""

    wish: Wish


@dataclass(frozen=True, slots=True)
class Refuse:
    """It is not done, and the asker is told so."""

    result: Result
    why: str


@dataclass(frozen=True, slots=True)
class Ignore:
    """It is none of our business: no answer."""


Verdict = Do | Refuse | Ignore


def addressed(target_system: int, target_component: int, system: int, component: int) -> bool:
    """To us alone, or to all components of our system. What is for all systems is not: nothing here is for a swarm."""
    return target_system == system and target_component in (0, component)


def judge(asked: Asked, allowed: Collection[str], *, signing: bool, command_age_s: float = 10.0) -> Verdict:
    """signing: on, so that only a signed command is obeyed, and only for so long."""
    try:
        wish: Wish | None = command.understand(asked.command, asked.params)
        wrong = ""
    except Unknown as error:
        if asked.whole:
            return Ignore()  # another component's; an answer of ours would be taken for the vehicle's
        return Refuse(Result.UNSUPPORTED, f"{error} is not known here")
    except Wrong as error:
        wish, wrong = None, str(error)
    if asked.whole and (wish is None or command.word(wish) not in READS):
        # MAV_CMD_USER_1 to all components means something else to an autopilot's scripts.
        return Ignore()
    if signing and not asked.signed:
        return Refuse(Result.DENIED, "it is not signed")
    if signing and asked.age_s > command_age_s:
        return Refuse(
            Result.DENIED,
            f"it was signed {asked.age_s:.0f} s ago by the newest time known here, allowed are {command_age_s:g} s "
            "(mavlink.signing.command_age): it was recorded, or the clock of its sender is behind",
        )
    if wish is None:
        return Refuse(Result.DENIED, wrong)
    needed: Word = command.word(wish)
    if needed.value not in allowed:
        return Refuse(Result.DENIED, f"{needed.value!r} is not among mavlink.commands")
    return Do(wish)
