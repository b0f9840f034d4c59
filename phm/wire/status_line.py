"""The lines an operator reads: MAVLink STATUSTEXT, one line each, at most 50 printable ASCII characters.

The contract. Every line begins with the agent (``A01`` to ``A250``) and a word; then comes the slot (1 to
15) or the array. The array has a digit for each of the slots 1 to 8: ``1`` OK or WARN, ``0`` ERROR,
``-`` not known or unused::

    A01 FAIL 6 node_1 dead                    a fault, at its cause
    A01 WARN 9 disk / 88%                     something to look at
    A01 OK 6 restart fixed: node_1 dead       over, by what PHM did
    A01 OK 6 cleared itself: node_1 dead      a fault that ended without an action of PHM
    A01 OK 9 cleared: disk / 88%              a warning that is over
    A01 WARN 6 flapping: node_1 dead          it fails and recovers again and again; told when it rests
    A01 ADVISE 2 restart ros_app #17          what PHM would do, and was told not to do; 17 is the fault's number
    A01 GAVE UP 2 ros_app exited #17          PHM cannot heal this: it is the operator's now
    A01 HOLD 2 ros_app 10 min: new firmware   an operator wants it left alone; what is bad there is not a failure
    A01 HOLD 2 ros_app over                   the end of that
    A01 OK 2 restart done: ros_app            what an operator asked for is done, and the container is well
    A01 WARN 2 restart failed: ros_app        it did not help, or was refused in the end
    A01 OK 11111111                           the refresh: all is well
    A01 WARN 11111111 9 disk / 88%            the refresh: worst unit first
    A01 FAIL 11111011 6 node_1 dead +2        the refresh: two more units are bad
    A01 STALE 11111--- 6                      the refresh: nothing is known to be bad, but not all is known
    A01 HOLD 1-1--111 2 ros_app on hold       the refresh: the same, and all that is not known is on hold

Names come from outside and are data: what is not printable ASCII becomes ``?``, and what is too long is
cut in its middle (``..``), because a name's head and the last word say most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum

from phm.core.model import ON_HOLD, Level, Slot, UnitState, worst_by_slot

MAX_CHARS = 50
"""Of a STATUSTEXT that needs no chunks: ground stations do not join chunks of component 193."""
ARRAY_SLOTS = tuple(Slot)[:8]
MISSION_SLOTS = frozenset(ARRAY_SLOTS)
"""An ERROR here means that the mission's function is lost; elsewhere something redundant is."""

_WORD = {Level.OK: "OK", Level.WARN: "WARN", Level.ERROR: "FAIL", Level.STALE: "STALE"}
_RANK = {Level.ERROR: 0, Level.WARN: 1, Level.STALE: 2, Level.OK: 3}


class Severity(IntEnum):
    """The part of MAV_SEVERITY that is used. QGroundControl pops up <= 3 and speaks <= 5."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


def severity(level: Level, slot: Slot) -> Severity:
    """Of a line that tells a change to `level`: lost mission function, lost redundancy, warning, resolved."""
    if level is Level.ERROR:
        return Severity.CRITICAL if slot in MISSION_SLOTS else Severity.ERROR
    return {Level.WARN: Severity.WARNING, Level.OK: Severity.NOTICE}.get(level, Severity.INFO)


def agent_name(agent: int) -> str:
    """``A01`` to ``A250``."""
    return f"A{agent:02d}"


def array_digits(levels: Mapping[Slot, Level]) -> str:
    """Eight characters, slots 1 to 8."""
    digit = {Level.OK: "1", Level.WARN: "1", Level.ERROR: "0", Level.STALE: "-"}
    return "".join(digit[levels.get(slot, Level.STALE)] for slot in ARRAY_SLOTS)


def failing(agent: int, level: Level, slot: Slot, brief: str) -> str:
    """A unit has become WARN or ERROR. `brief` as in `Result.brief`."""
    return _line(f"{agent_name(agent)} {_WORD[level]} {slot:d}", brief)


def recovered(agent: int, slot: Slot, brief: str, by: str = "") -> str:
    """A unit is OK again. `by`: ``itself``, an action's name, or empty when it was only a warning."""
    how = {"": "cleared", "itself": "cleared itself"}.get(by, f"{_short(by, 12)} fixed")
    return _line(f"{agent_name(agent)} OK {slot:d} {how}:", brief)


def flapping(agent: int, slot: Slot, brief: str) -> str:
    """A unit fails and recovers again and again; it is not told each time."""
    return _line(f"{agent_name(agent)} WARN {slot:d} flapping:", brief)


def advise(agent: int, slot: Slot, action: str, target: str, number: int | None = None) -> str:
    """`number`: the fault's, by which an operator approves; None when it has none. Names are cut, it never is."""
    return _line(f"{agent_name(agent)} ADVISE {slot:d} {_short(action, 16)}", target, _numbered(number))


def approved(agent: int, slot: Slot, action: str, target: str) -> str:
    return _line(f"{agent_name(agent)} APPROVED {slot:d} {_short(action, 16)}", target)


def expired(agent: int, slot: Slot, action: str, target: str) -> str:
    """An approval no longer holds, and what it was for was not done."""
    return _line(f"{agent_name(agent)} EXPIRED {slot:d} {_short(action, 16)}", target)


def gave_up(agent: int, slot: Slot, target: str, brief: str, number: int | None = None) -> str:
    """`number`: as of `advise`."""
    said = brief if target in brief else f"{_short(target, 16)}: {brief}"
    return _line(f"{agent_name(agent)} GAVE UP {slot:d}", said, _numbered(number))


def operator_request(agent: int, slot: Slot, action: str, end: str, target: str) -> str:
    """How something ended that an operator had asked for. `end`: ``done``, ``failed`` or ``refused``."""
    word = "OK" if end == "done" else "WARN"
    return _line(f"{agent_name(agent)} {word} {slot:d} {_short(action, 16)} {end}:", target)


def hold(agent: int, slot: Slot, target: str, for_s: float | None, reason: str) -> str:
    """A hold on `target` (empty: all containers) begins, for so many seconds; None: it is over."""
    head = f"{agent_name(agent)} HOLD {slot:d}"
    if for_s is None:
        return _line(head, target or "all", " over")
    length = f"{for_s:.0f} s" if for_s < 120 else f"{for_s / 60:.0f} min"
    return _line(head, f"{_short(target or 'all', 16)} {length}{': ' if reason else ''}{reason}")


def refresh(agent: int, units: Sequence[UnitState]) -> str:
    """How the whole agent is, in one line."""
    levels = worst_by_slot(tuple(units))
    ranked = worst_first(units)
    worst = ranked[0] if ranked else None
    level = worst.level if worst is not None else Level.STALE
    head = f"{agent_name(agent)} {_WORD[level]} {array_digits(levels)}"
    if worst is None or level is Level.OK:
        return head
    if level is Level.STALE:
        held = _held(ranked)
        if held is not None:
            return _line(head.replace("STALE", "HOLD", 1) + f" {held.slot:d}", brief_of(held))
        return f"{head} {worst.slot:d}"
    more = sum(1 for state in ranked if state.level.bad) - 1
    return _line(f"{head} {worst.slot:d}", brief_of(worst), f" +{more}" if more else "")


def _held(ranked: Sequence[UnitState]) -> UnitState | None:
    """The first unit on hold; None where something else is not known either."""
    unknown = [state for state in ranked if state.level is Level.STALE and not state.blocked_by]
    held = [state for state in unknown if state.result.condition == ON_HOLD]
    return held[0] if held and len(held) == len(unknown) else None


def worst_first(units: Sequence[UnitState]) -> list[UnitState]:
    """ERROR, WARN, STALE, OK; within a level by slot, and in the given order within a slot."""
    return sorted(units, key=lambda state: (_RANK[state.level], state.slot))


def brief_of(state: UnitState) -> str:
    """The check's own few words, else the unit's name: a bad unit is never told without a subject."""
    return state.result.brief or state.unit


def _numbered(number: int | None) -> str:
    return "" if number is None else f" #{number}"


def _line(head: str, text: str, tail: str = "") -> str:
    """`head text tail` in MAX_CHARS; only `text` is cut."""
    return f"{head} {_short(text, MAX_CHARS - len(head) - 1 - len(tail))}".rstrip() + tail


def _short(text: str, room: int) -> str:
    """`text` as printable ASCII in at most `room` (>= 4) characters, cut in the middle when too long."""
    # Long texts are cut before they are looked at: a name from outside may have any length.
    if len(text) > 1000:
        text = f"{text[:500]}{text[-500:]}"
    clean = "".join(char if " " <= char <= "~" else "?" for char in text).strip()
    if len(clean) <= room:
        return clean
    head = (room - 2 + 1) // 2
    return f"{clean[:head]}..{clean[len(clean) - (room - 2 - head) :]}" if room - 2 > head else clean[:room]
