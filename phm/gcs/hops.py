"""Where the path from the ground to an agent's autopilot is broken, as the ground sees it. Pure.

An agent reports the first broken hop of its own path in its lines (`docs/reference/mavlink.md`, The path). The ground adds what
no agent can report: that it is not received, and whether its autopilot or other agents still are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phm.core.model import Level, Slot
from phm.gcs.agent import Agent
from phm.gcs.presence import PresenceState
from phm.wire.status_line import agent_name

_PLACES = ("port", "router", "link", "radio", "autopilot", "GCS")
"""How a line about a hop begins: `port ground: no permission`."""


@dataclass(frozen=True, slots=True)
class BrokenHop:
    """certain: it follows from received data; else it is only the first place to check."""

    name: str
    evidence: str
    certain: bool = True


@dataclass(frozen=True, slots=True)
class HopEvidence:
    """What else the ground knows when it looks for the broken hop of one agent.

    closed: why no link of the ground is open, else empty. all_silent: no sender is received any more. autopilot: the vehicle's
    autopilot is received. autopilot_lost_s: for how long it is no longer received, None: it is, or never was. received_by: other agents
    that receive it. radio: a radio on the ground's own link answers.
    """

    closed: str = ""
    all_silent: bool = False
    autopilot: bool = False
    received_by: Sequence[int] = ()
    radio: bool = False
    autopilot_lost_s: float | None = None


def first_broken(agent: Agent, state: PresenceState, silent_s: float | None, around: HopEvidence) -> BrokenHop | None:
    """The first broken hop of a path; None: no hop is known to be broken."""
    if state is PresenceState.LEFT:
        return None
    return (_reported(agent) or _autopilot(around)) if state.there else _silent(silent_s, around)


def _autopilot(around: HopEvidence) -> BrokenHop | None:
    """The agent reports nothing, and the ground does not receive its autopilot any more."""
    silent_s = around.autopilot_lost_s
    return None if silent_s is None else BrokenHop("autopilot", f"silent {silent_s:.0f} s here", certain=False)


def _silent(silent_s: float | None, around: HopEvidence) -> BrokenHop | None:
    since = "never received" if silent_s is None else f"silent {silent_s:.0f} s"
    if around.closed:
        return BrokenHop("ground link", around.closed)
    if around.autopilot:
        return BrokenHop("companion", f"PHM {since}, autopilot received")
    if around.received_by:
        return BrokenHop("radio", f"{since} here, received by {' '.join(map(agent_name, around.received_by))}")
    if around.all_silent and around.radio:
        return BrokenHop("radio", "all agents are silent, the ground's radio answers", certain=False)
    if around.all_silent:
        return BrokenHop("ground link", "all agents are silent", certain=False)
    return BrokenHop("radio or vehicle", since, certain=False)


def _reported(agent: Agent) -> BrokenHop | None:
    """From the ground to the autopilot, by the agent's own reports."""
    ground, radio = _bad(agent, Slot.COMPANION), _bad(agent, Slot.RADIO)
    name = _place(ground)
    if ground is not None and name == "GCS":
        return BrokenHop(name, _rest(ground))
    if radio is not None:
        return BrokenHop(_place(radio) or "radio", _rest(radio))
    if ground is not None:
        return BrokenHop(name or "companion", _rest(ground), certain=bool(name))
    if agent.no_ground:
        return BrokenHop("radio", "it does not receive the ground station", certain=False)
    for slot in (Slot.CONTAINER, Slot.NODES):
        # Only the agent knows whether the failed unit forwards commands.
        application = _bad(agent, slot)
        if application is not None:
            return BrokenHop("application", application, certain=False)
    autopilot = _bad(agent, Slot.AUTOPILOT)
    return None if autopilot is None else BrokenHop(_place(autopilot) or "autopilot", _rest(autopilot))


def _bad(agent: Agent, slot: Slot) -> str | None:
    """The text of an ERROR in this slot."""
    reported = agent.newest(slot, Level.ERROR)
    if reported is not None:
        return reported.text
    return f"ERROR in slot {slot:d}, cause not received" if agent.levels.get(slot) is Level.ERROR else None


def _place(words: str | None) -> str:
    """The hop that a line names, else empty."""
    head, colon, _ = (words or "").partition(": ")
    return head if colon and head.split(" ")[0] in _PLACES else ""


def _rest(words: str) -> str:
    return words.partition(": ")[2] if _place(words) else words
