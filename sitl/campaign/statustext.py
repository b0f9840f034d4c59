"""Which STATUSTEXT lines at the ground report a fault. Pure."""

from __future__ import annotations

import re

from sitl.campaign.trial import Alarm, Injection, Line, RaisedWarning, Trial
from sitl.campaign.verdict import BESIDE, PEERS

_TAIL = re.compile(r" (?:\+\d+|#\d+)$")
_MEASURED = re.compile(r"\d+(?:\.\d+)?(?= ?(?:%|Hz|MB|V|m?s\b))")
"""A value may change between the alarm and a later line about it."""


def reports(line: Line, fault: Injection, first: Alarm | RaisedWarning, trial: Trial) -> bool:
    """Whether a line reports the fault, which PHM detected by `first`: the agent's own line since then, or another
    agent's, which may notice the fault earlier.
    """
    if by_others(line, fault):
        return True
    brief = first.brief if _shared(fault, first, trial) else ""
    return line.mono >= first.mono and own(line, fault, first.slot, brief)


def own(line: Line, fault: Injection, slot: int, brief: str = "") -> bool:
    """Whether a line reports a bad state of this agent in that slot: a change, or the refresh. `brief`: text that it
    must have; empty: any.
    """
    words = "FAIL|GAVE UP|WARN" if fault.level == "WARN" else "FAIL|GAVE UP"
    found = re.match(rf"A{fault.agent:02d} (?:{words}) (?:[01-]{{8}} )?{slot}\b(.*)", line.text)
    return found is not None and (not brief or _same(found[1].strip(), brief))


def by_others(line: Line, fault: Injection) -> bool:
    """Whether another agent reports the fault."""
    who = f"A{fault.agent:02d}"
    if re.match(rf"{who} no GCS radio", line.text):
        return fault.layer == "link"
    reported = re.search(rf" (FAIL|WARN) 12 .*\b({who}|split)\b", line.text)
    return fault.unit.startswith(PEERS) and reported is not None and not line.text.startswith(who)


def _shared(fault: Injection, first: Alarm | RaisedWarning, trial: Trial) -> bool:
    """Whether other units of the agent are reported in this slot: of the machine, possibly since before the trial."""
    known: list[Alarm | RaisedWarning] = [*trial.alarms, *trial.warned]
    return fault.unit.startswith(BESIDE) or any(
        (each.agent, each.slot) == (first.agent, first.slot) and each.unit != first.unit for each in known
    )


def _same(text: str, brief: str) -> bool:
    """Whether the text of a line is this brief, possibly cut in its middle, or with the container before it."""
    said = _MEASURED.sub("0", _TAIL.sub("", text))
    wanted = _MEASURED.sub("0", "".join(char if " " <= char <= "~" else "?" for char in brief).strip())
    head, cut, tail = said.partition("..")
    if cut and wanted.startswith(head) and wanted.endswith(tail):
        return True
    return said == wanted or said.endswith(f": {wanted}")
