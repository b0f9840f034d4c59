"""The lines an operator reads: MAVLink STATUSTEXT, one line each, at most 50 printable ASCII characters.

A contract. Every line begins with the agent (``A01`` to ``A250``) and a word. The slot (1 to 15) or the array follows.
The array has a digit for each of the slots 1 to 8: ``1`` OK or WARN, ``0`` ERROR, ``-`` unknown or unused::

    A01 FAIL 6 node_1 dead                    a fault, reported at its cause
    A01 WARN 9 disk / 88 %                    a warning
    A01 OK 6 node_1 restarted                 the fault ended by an action of PHM
    A01 OK 6 node_1 recovered                 the fault ended without an action of PHM
    A01 OK 1 recovered: GCS: no heartbeat 3 s the same where the failure begins with no name
    A01 OK 9 cleared: disk / 88 %             the warning ended
    A01 WARN 6 flapping: node_1 dead          it fails and recovers repeatedly; reported again when it is stable
    A01 ADVISE 2 restart ros_app #17 60s      the action that PHM recommends; 17 is the number of the fault; once given, an
                                              approval is valid for 60 s
    A01 GAVE UP 2 ros_app exited #17          PHM cannot fix this: the operator has to
    A01 HOLD 2 ros_app 10 min: new firmware   an operator holds the container: PHM does nothing to it
    A01 HOLD 2 ros_app released               the hold ended
    A01 OK 2 restart done: ros_app            the operator's request succeeded, and the container is OK
    A01 WARN 2 restart failed: ros_app        the operator's request failed or was refused
    A01 OK 11111111                           refresh: everything is OK
    A01 WARN 11111111 9 disk / 88 %           refresh: the worst unit
    A01 FAIL 11111011 6 node_1 dead +2        refresh: two more units are not OK
    A01 STALE 11111--- 6                      refresh: no failure is known, but some slots are unknown
    A01 HOLD 1-1--111 2 ros_app on hold       refresh: the same, and all unknown slots are on hold

Names come from outside and are data: a character that is not printable ASCII becomes ``?``. A text that is too long is
cut in its middle (``..``), because its beginning and its last word say most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum

from phm.core.model import ON_HOLD, Level, Slot, UnitState, worst_by_slot

MAX_CHARS = 50
"""The length of a STATUSTEXT without chunks: ground stations do not join chunks of component 193."""
MAX_SUBJECT = 16
PAST_VERBS: Mapping[str, str] = {
    "": "cleared",
    "itself": "recovered",
    "start": "started",
    "restart": "restarted",
    "unpause": "unpaused",
    "reconnect": "reconnected",
    "join_network": "connected",
    "relaunch": "relaunched",
    "restore_file": "restored",
    "reopen": "reopened",
    "free_disk": "freed",
    "relieve": "relieved",
    "reboot": "rebooted",
}
"""What happened to a unit that is OK again, by what ended its fault."""
ARRAY_SLOTS = tuple(Slot)[:8]
MISSION_SLOTS = frozenset(ARRAY_SLOTS)
"""An ERROR in one of these means lost mission function; in others, lost redundancy."""

_WORD = {Level.OK: "OK", Level.WARN: "WARN", Level.ERROR: "FAIL", Level.STALE: "STALE"}


class Severity(IntEnum):
    """The levels of MAV_SEVERITY that PHM uses. QGroundControl shows a pop-up for <= 3 and speaks <= 5."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


def severity(level: Level, slot: Slot) -> Severity:
    """Severity of a change to `level`: lost mission function, lost redundancy, warning, resolved."""
    if level is Level.ERROR:
        return Severity.CRITICAL if slot in MISSION_SLOTS else Severity.ERROR
    return {Level.WARN: Severity.WARNING, Level.OK: Severity.NOTICE}.get(level, Severity.INFO)


def agent_name(agent: int) -> str:
    """The name of an agent, ``A01`` to ``A250``."""
    return f"A{agent:02d}"


def array_digits(levels: Mapping[Slot, Level]) -> str:
    """The eight characters for slots 1 to 8."""
    digit = {Level.OK: "1", Level.WARN: "1", Level.ERROR: "0", Level.STALE: "-"}
    return "".join(digit[levels.get(slot, Level.STALE)] for slot in ARRAY_SLOTS)


def failing(agent: int, level: Level, slot: Slot, brief: str) -> str:
    """A unit became WARN or ERROR. `brief` as in `Result.brief`."""
    return _line(f"{agent_name(agent)} {_WORD[level]} {slot:d}", brief)


def recovered(agent: int, slot: Slot, brief: str, by: str = "", subject: str = "") -> str:
    """A unit is OK again.

    brief: the failure that ended. by: ``itself``, the name of an action, or empty for a warning. subject: a name that
    identifies the unit in its slot; the line has the brief instead where this is empty.
    """
    verb = PAST_VERBS.get(by) or f"fixed by {shortened(by, 12)}"
    head = f"{agent_name(agent)} OK {slot:d}"
    return f"{head} {subject} {verb}" if subject and by else _line(f"{head} {verb}:", brief)


def subject_of(state: UnitState) -> str:
    """The name of the unit with which its brief begins, e.g. ``node_1`` of ``node_1 dead``; empty if there is none."""
    name = brief_of(state).partition(" ")[0]
    named = f"/{state.unit}".endswith(f"/{name}") and len(name) <= MAX_SUBJECT
    return name if named and all(" " < char <= "~" for char in name) else ""


def flapping(agent: int, slot: Slot, brief: str) -> str:
    """A unit fails and recovers repeatedly; its changes are not reported one by one."""
    return _line(f"{agent_name(agent)} WARN {slot:d} flapping:", brief)


def advise(
    agent: int, slot: Slot, action: str, target: str, number: int | None = None, valid_s: float | None = None
) -> str:
    """PHM recommends an action. `number`: of the fault, with which an operator approves; None if it has none. `valid_s`: how long
    an approval is valid after it was given. Both are never cut.
    """
    tail = _numbered(number) + (f" {valid_s:.0f}s" if number is not None and valid_s is not None else "")
    return _line(f"{agent_name(agent)} ADVISE {slot:d} {shortened(action, 16)}", target, tail)


def approved(agent: int, slot: Slot, action: str, target: str) -> str:
    return _line(f"{agent_name(agent)} APPROVED {slot:d} {shortened(action, 16)}", target)


def expired(agent: int, slot: Slot, action: str, target: str) -> str:
    """An approval expired before its action was done."""
    return _line(f"{agent_name(agent)} EXPIRED {slot:d} {shortened(action, 16)}", target)


def gave_up(agent: int, slot: Slot, target: str, brief: str, number: int | None = None) -> str:
    """PHM cannot fix the fault. `number`: as in `advise`."""
    said = brief if target in brief else f"{shortened(target, 16)}: {brief}"
    return _line(f"{agent_name(agent)} GAVE UP {slot:d}", said, _numbered(number))


def operator_request(agent: int, slot: Slot, action: str, end: str, target: str) -> str:
    """The result of an operator's request. `end`: ``done``, ``failed`` or ``refused``."""
    word = "OK" if end == "done" else "WARN"
    return _line(f"{agent_name(agent)} {word} {slot:d} {shortened(action, 16)} {end}:", target)


def hold(agent: int, slot: Slot, target: str, for_s: float | None, reason: str) -> str:
    """A hold on `target` (empty: all containers) begins for `for_s` seconds; None: it ended."""
    head = f"{agent_name(agent)} HOLD {slot:d}"
    if for_s is None:
        return _line(head, target or "all", " released")
    length = f"{for_s:.0f} s" if for_s < 120 else f"{for_s / 60:.0f} min"
    return _line(head, f"{shortened(target or 'all', 16)} {length}{': ' if reason else ''}{reason}")


def refresh(agent: int, units: Sequence[UnitState]) -> str:
    """The status of the agent in one line."""
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
    """The first unit on hold; None if another unit is unknown for another reason."""
    unknown = [state for state in ranked if state.level is Level.STALE and not state.blocked_by]
    held = [state for state in unknown if state.result.condition == ON_HOLD]
    return held[0] if held and len(held) == len(unknown) else None


def worst_first(units: Sequence[UnitState]) -> list[UnitState]:
    """ERROR, WARN, STALE, OK; within a level by slot, and in the given order within a slot."""
    return sorted(units, key=lambda state: (-state.level.severity, state.slot))


def brief_of(state: UnitState) -> str:
    """The check's short text, else the name of the unit, so that a line always has a subject."""
    return state.result.brief or state.unit


def _numbered(number: int | None) -> str:
    return "" if number is None else f" #{number}"


def _line(head: str, text: str, tail: str = "") -> str:
    """`head text tail` in MAX_CHARS; only `text` is cut."""
    return f"{head} {shortened(text, MAX_CHARS - len(head) - 1 - len(tail))}".rstrip() + tail


def shortened(text: str, room: int) -> str:
    """`text` as printable ASCII in at most `room` (>= 4) characters, cut in the middle when too long."""
    # Cut before anything else: a name from outside may have any length.
    if len(text) > 1000:
        text = f"{text[:500]}{text[-500:]}"
    clean = "".join(char if " " <= char <= "~" else "?" for char in text).strip()
    if len(clean) <= room:
        return clean
    head = (room - 2 + 1) // 2
    return f"{clean[:head]}..{clean[len(clean) - (room - 2 - head) :]}" if room - 2 > head else clean[:room]
