"""The status of an agent as it goes over Zenoh: one small JSON object. Pure; `docs/reference/fleet.md` states the keys as a contract.

Keys of Zenoh::

    phm/<fleet>/<agent>/status          the status; a query is answered with the newest one
    phm/<fleet>/<agent>/alive/<boot>    a liveliness token while this PHM monitors the agent
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phm.core.model import Fault, Level, Slot, Stamp, UnitState, worst_by_slot
from phm.wire import status_line, status_word
from phm.wire.report import iso

VERSION = 1
MAX_BYTES = 65536
"""Maximum size of a status; a reader refuses a larger one."""
MAX_FAULTS = 16
"""Open faults that are listed, oldest first; `open_faults` counts all."""
MAX_TEXT = 200
_CUT = 100
"""Characters of each text of a fault: with all of them at their longest the whole stays below MAX_BYTES."""
STATES = {
    status_word.BOOT: "BOOT",
    status_word.ACTIVE: "ACTIVE",
    status_word.CRITICAL: "CRITICAL",
    status_word.EMERGENCY: "EMERGENCY",
    8: "POWEROFF",
}
"""As HEARTBEAT's `system_status` of MAVLink."""
POWEROFF = "POWEROFF"
PATH_UNIT = "path"


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """What a reader gets.

    agent, agent_id: as in the configuration of the agent. boot_id: one run of its PHM; sequence: 1, 2, 3 ... within it.
    utc, utc_s, mono_s: when, on the clocks of the agent, which may be wrong; differences of mono_s are durations.
    levels: of the slots that are used. broken: the first hop at which a command from the ground stops; None: not known, empty: none.
    """

    agent: str
    agent_id: int
    boot_id: str
    sequence: int
    utc: str
    utc_s: float
    mono_s: float
    state: str
    word: int
    levels: Mapping[Slot, Level]
    line: str
    broken: str | None
    open_faults: int
    faults: tuple[Mapping[str, Any], ...]


def key(fleet: str, agent: str) -> str:
    """Of the status. Both are names of the configuration, which allows nothing that means something to Zenoh."""
    return f"phm/{fleet}/{agent}/status"


def alive_key(fleet: str, agent: str, boot_id: str) -> str:
    return f"phm/{fleet}/{agent}/alive/{boot_id}"


def encode(
    agent: tuple[str, int],
    boot_id: str,
    sequence: int,
    at: Stamp,
    states: Sequence[UnitState],
    faults: Sequence[Fault],
    state: str,
) -> bytes:
    """The payload, ASCII. agent: name and id. faults: those that are open, oldest first."""
    levels = worst_by_slot(tuple(states))
    document = {
        "v": VERSION,
        "agent": agent[0],
        "agent_id": agent[1],
        "boot_id": boot_id,
        "seq": sequence,
        "utc": iso(at.utc),
        "utc_s": round(at.utc, 3),
        "mono": round(at.mono, 3),
        "state": state,
        "status_word": status_word.encode(levels),
        "slots": {str(int(slot)): levels[slot].name for slot in sorted(levels)},
        "line": status_line.refresh(agent[1], states),
        "broken_hop": first_broken_hop(states),
        "open_faults": len(faults),
        "faults": [_fault(fault) for fault in faults[:MAX_FAULTS]],
    }
    return json.dumps(document, separators=(",", ":")).encode("ascii")


def first_broken_hop(states: Sequence[UnitState]) -> str | None:
    """The first broken hop on the path of a command, by the path check; empty: none; None: not checked."""
    path = next((state for state in states if state.unit == PATH_UNIT), None)
    if path is None:
        return None
    hop = path.result.evidence.broken_hop
    if hop or path.blocked_by:
        return (hop or path.blocked_by)[:_CUT]
    return "" if path.level is Level.OK and not path.not_applicable else None


def decode(payload: bytes) -> FleetStatus:
    """The status in a payload. Raises ValueError if a part is missing, of a wrong type, or of another version: it comes from outside."""
    if len(payload) > MAX_BYTES:
        raise ValueError(f"a status of {len(payload)} bytes is too long: {MAX_BYTES} are allowed")
    try:
        document = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a status is not valid JSON: {error}") from None
    if not isinstance(document, dict) or document.get("v") != VERSION:
        raise ValueError(f"this is not a status of version {VERSION}")
    slots, faults, hop = document.get("slots"), document.get("faults"), document.get("broken_hop")
    if not isinstance(slots, dict) or not isinstance(faults, list) or not isinstance(hop, str | None):
        raise ValueError("slots, faults or broken_hop of a status are of the wrong type")
    return FleetStatus(
        agent=_text(document, "agent"),
        agent_id=_whole(document, "agent_id"),
        boot_id=_text(document, "boot_id"),
        sequence=_whole(document, "seq"),
        utc=_text(document, "utc"),
        utc_s=_number(document, "utc_s"),
        mono_s=_number(document, "mono"),
        state=_text(document, "state"),
        word=_whole(document, "status_word"),
        levels=dict(_level(number, name) for number, name in slots.items()),
        line=_text(document, "line"),
        broken=hop,
        open_faults=_whole(document, "open_faults"),
        faults=tuple(fault for fault in faults[:MAX_FAULTS] if isinstance(fault, dict)),
    )


def _fault(fault: Fault) -> dict[str, Any]:
    return {
        "fault": fault.id,
        "unit": fault.unit[:_CUT],
        "slot": int(fault.slot),
        "condition": fault.result.condition[:_CUT],
        "brief": fault.result.brief[:_CUT],
        "opened": iso(fault.opened.utc),
    }


def _level(number: str, name: Any) -> tuple[Slot, Level]:
    try:
        return Slot(int(number)), Level[name]
    except (KeyError, ValueError, TypeError):
        raise ValueError(f"slot {number!r} of a status has no level that is known") from None


def _text(document: Mapping[str, Any], name: str) -> str:
    value = document.get(name)
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise ValueError(f"{name} of a status is not a text of at most {MAX_TEXT} characters")
    return value


def _whole(document: Mapping[str, Any], name: str) -> int:
    value = document.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
        raise ValueError(f"{name} of a status is not an integer")
    return value


def _number(document: Mapping[str, Any], name: str) -> float:
    value = document.get(name)
    if not isinstance(value, int | float) or isinstance(value, bool) or value != value or abs(value) > 1e18:
        raise ValueError(f"{name} of a status is not a number")
    return float(value)
