"""How the demonstration evaluates a record and the lines received on the ground."""

from __future__ import annotations

from typing import Any

from phm.core.model import Slot
from sitl.demo.main import Outcome, judge
from sitl.faults import all_faults
from sitl.simulation.ground import TextLine

FAULT = all_faults()["node_killed"]
UNIT = "node/node_1"
BEGAN = 100.0


def opened(unit: str, slot: Slot, mono: float) -> dict[str, Any]:
    return {"event": "fault_opened", "unit": unit, "slot": int(slot), "mono": mono, "summary": "bad"}


def verified(unit: str, mono: float) -> dict[str, Any]:
    return {"event": "action", "phase": "verified", "unit": unit, "action": "restart", "mono": mono}


def line(text: str, mono: float) -> TextLine:
    return TextLine(0.0, mono, 1, 193, 2, text)


def judged(*lines: TextLine) -> Outcome:
    events = [
        opened("host/cpu", Slot.HOST, BEGAN - 1),
        opened(UNIT, Slot.NODES, BEGAN + 0.5),
        verified(UNIT, BEGAN + 4),
    ]
    return judge(FAULT, UNIT, BEGAN, events, lines)


def test_the_line_about_the_injected_fault_counts_as_received() -> None:
    """As a change or in the refresh, whatever the agent reports before it."""
    busy = line("A01 FAIL 9 CPU 100%", BEGAN - 0.9)
    change, refresh = line("A01 FAIL 6 node_1 dead", BEGAN + 0.6), line("A01 FAIL 11111011 6 node_1 dead", BEGAN + 2)
    found = judged(busy, change, refresh)
    assert (found.reported_s, found.good, len(found.opened)) == (change.mono - BEGAN, True, 1)
    assert judged(busy, refresh).reported_s == refresh.mono - BEGAN


def test_a_line_about_another_slot_does_not_count() -> None:
    """An alarm about host load does not prove that the ground knows the fault."""
    found = judged(
        line("A01 FAIL 9 CPU 100%", BEGAN + 0.6), line("A01 WARN 6 node_1 slow", BEGAN + 0.7), line("FAIL", 101.0)
    )
    assert found.reported_s is None and not found.good
