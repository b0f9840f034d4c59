"""The status word: how an agent is, in the 32 bits of a HEARTBEAT's ``custom_mode``.

Layout, least significant bit first::

    bits  0-1   slot 1        2 bits a slot: 0 unknown (STALE) or unused, 1 OK, 2 WARN, 3 ERROR
    bits  2-3   slot 2
    ...
    bits 28-29  slot 15
    bits 30-31  version of this layout, now 1

An all-zero word, as every program that does not use the field sends it, has version 0 and claims nothing.
Example: slots 1 to 8 OK but slot 6 ERROR, slot 9 WARN: ``0x40025D55``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from phm.core.model import Level, Slot, UnitState
from phm.wire.status_line import MISSION_SLOTS

VERSION = 1
BOOT, ACTIVE, CRITICAL, EMERGENCY = 1, 4, 5, 6
"""The part of MAV_STATE that is used while PHM runs."""

_VERSION_SHIFT = 30
_CODE = {Level.STALE: 0, Level.OK: 1, Level.WARN: 2, Level.ERROR: 3}
_LEVEL = {code: level for level, code in _CODE.items() if code}
_SHIFT = {slot: 2 * (slot - 1) for slot in Slot}


def encode(levels: Mapping[Slot, Level]) -> int:
    """The word, 0 to 2**32 - 1, for the level of each slot (`worst_by_slot`); slots left out are unused."""
    word = VERSION << _VERSION_SHIFT
    for slot, level in levels.items():
        word |= _CODE[level] << 2 * (slot - 1)
    return word


def decode(word: int) -> dict[Slot, Level]:
    """Levels by slot; a slot that is missing is unknown. Empty for word 0.

    Raises ValueError for a word that is not one of ours: more than 32 bits, or another version.
    """
    if word == 0:
        return {}
    if not 0 < word < 2**32:
        raise ValueError(f"{word} is not a status word: it has more than 32 bits")
    version = word >> _VERSION_SHIFT
    if version != VERSION:
        raise ValueError(f"0x{word:08X} is a status word of version {version}; this program reads version {VERSION}")
    return {slot: _LEVEL[code] for slot, shift in _SHIFT.items() if (code := word >> shift & 3)}


def system_status(states: Iterable[UnitState], *, complete: bool) -> int:
    """HEARTBEAT's `system_status` that goes with the word. complete: a first report is done."""
    if not complete:
        return BOOT
    bad = [state for state in states if state.level.bad]
    if any(state.level is Level.ERROR and state.slot in MISSION_SLOTS for state in bad):
        return EMERGENCY
    return CRITICAL if bad else ACTIVE
