"""The fleet's state as JSON: bodies of events and complete snapshots. Pure. The keys are a contract: `docs/reference/gcs.md`.

What is unknown is null or missing, never a guess; the slots of a lost agent are only in `last_slots`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from phm.core.model import Level, Slot, Stamp
from phm.gcs.agent import Agent
from phm.gcs.events import severity_name
from phm.gcs.fleet import Autopilot, Fleet, FleetSnapshot, SwarmState
from phm.gcs.frames import BOOT, StatusText, state_name
from phm.gcs.hops import BrokenHop
from phm.gcs.presence import PresenceState
from phm.gcs.statustext_parser import ParsedLine
from phm.wire.report import iso
from phm.wire.tunnel import PeerView, SwarmDigest

UNKNOWN = "UNKNOWN"
_RADIO = ("rssi", "remrssi", "noise", "remnoise", "txbuf")


@dataclass(frozen=True, slots=True)
class Times:
    """How moments are given: as seconds before `now` (`age_s`), or, for a page that counts up itself, unchanged (`at`). All are
    monotonic seconds of the ground."""

    now: float
    moments: bool = False

    def of(self, mono: float | None, prefix: str = "") -> dict[str, float | None]:
        """One key with its value; None: the moment never came."""
        if self.moments:
            return {f"{prefix}at": None if mono is None else round(mono, 2)}
        return {f"{prefix}age_s": None if mono is None else seconds(max(0.0, self.now - mono))}


def who(agent: Agent) -> dict[str, Any]:
    return {"agent": agent.system, "name": agent.name}


def word(agent: Agent) -> dict[str, Any]:
    """The content of its last heartbeat."""
    return {"word": agent.word, "state": state_name(agent.state), "slots": slots(agent.levels)}


def slots(levels: Mapping[Slot, Level]) -> dict[str, str]:
    return {str(int(slot)): level.name for slot, level in sorted(levels.items())}


def hop(found: BrokenHop | None) -> dict[str, Any] | None:
    return None if found is None else asdict(found)


def autopilot_fields(found: Autopilot, now: float, times: Times | None = None) -> dict[str, Any]:
    return {
        "presence": found.phase(now).value,
        "armed": found.armed,
        "mode": found.mode,
        "state": state_name(found.state),
        **(times or Times(now)).of(found.presence.received_s),
    }


def text(said: StatusText, line: ParsedLine | None) -> dict[str, Any]:
    """line: the parsed line of a PHM; None: another program sent it."""
    body: dict[str, Any] = {
        "system": said.system,
        "component": said.component,
        "severity": said.severity,
        "severity_name": severity_name(said.severity),
        "text": said.text,
        "phm": line is not None,
    }
    if line is not None:
        about = {"agent": line.agent or None, "kind": line.kind.value, "word": line.word or None}
        body = {**body, **about, "slot": line.slot or None, "brief": line.text}
    return body


def view(said: PeerView) -> dict[str, Any]:
    peers = {str(number): seen.name.lower() for number, seen in sorted(said.peers.items())}
    return {"gcs": said.gcs, "autopilot": said.autopilot, "radio": said.radio, "peers": peers}


def digest(said: SwarmDigest) -> dict[str, Any]:
    levels = {str(number): level.name for number, level in sorted(said.levels.items())}
    return {"members": said.members, "alive": said.alive, "levels": levels}


def agent_status(agent: Agent, state: PresenceState, *, autopilot_lost: bool = False) -> str:
    """One word for an agent: OK, WARN, ERROR, STALE, HOLD, BOOT, LOST, LEFT, UNKNOWN. autopilot_lost: the ground has received the
    vehicle's autopilot, and no longer does: ERROR, whatever the agent reports."""
    if not state.there:
        return {PresenceState.LOST: "LOST", PresenceState.LEFT: "LEFT"}.get(state, UNKNOWN)
    if autopilot_lost:
        return Level.ERROR.name
    worst = agent.worst
    if agent.state == BOOT and worst not in (Level.WARN, Level.ERROR):
        return "BOOT"
    if agent.on_hold and worst in (Level.OK, Level.STALE):
        return "HOLD"
    return UNKNOWN if worst is None else worst.name


def fleet_json(
    fleet: Fleet, at: Stamp, *, moments: bool = False, only: Collection[int] | None = None
) -> dict[str, Any]:
    """The state of all agents at one moment. moments: see Times. only: ids of the agents to include; None: all."""
    current, times = fleet.snapshot(at.mono), Times(at.mono, moments)
    agents = sorted(fleet.agents.values(), key=lambda agent: (agent.system, agent.component))
    return {
        "agents": [_agent(fleet, current, agent, times) for agent in agents if only is None or agent.system in only],
        "autopilots": {
            str(system): autopilot_fields(found, at.mono, times) for system, found in sorted(fleet.autopilots.items())
        },
        "stations": [{"system": system, "component": component} for system, component in current.stations()],
        "radios": [
            {"link": link, **times.of(received), **{key: getattr(said, key) for key in _RADIO}}
            for link, (received, said) in fleet.radios.items()
        ],
        "swarm": _swarm(fleet.swarm, times),
        "links": [{"link": name, "open": is_open, "error": error} for name, (is_open, error) in fleet.links.items()],
        "refused": fleet.refused,
    }


def seconds(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def _agent(fleet: Fleet, current: FleetSnapshot, agent: Agent, times: Times) -> dict[str, Any]:
    now, state = times.now, current.state(agent)
    received_by, not_received_by = current.received_by(agent)
    said = fleet.swarm.digest
    level = said.levels.get(agent.system) if said is not None else None
    autopilot = fleet.autopilots.get(agent.system)
    learned = agent.presence.received_s is not None
    return {
        **who(agent),
        "component": agent.component,
        "link": agent.link or None,
        "how": agent_status(agent, state, autopilot_lost=autopilot is not None and autopilot.lost(now)),
        "presence": state.value,
        **times.of(agent.presence.received_s),
        "period_s": seconds(agent.presence.period_s(fleet.guess_s)) if learned else None,
        "word": agent.word,
        "state": state_name(agent.state) or None,
        "slots": slots(agent.current) if state.there else {},
        "last_slots": slots(agent.levels),
        "hop": hop(current.hop(agent)),
        "line": _line(agent, times),
        "bad": _bad(agent, times) if state.there else [],
        "advice": _advice(agent, times) if state.there else [],
        "containers": list(agent.containers),
        "view": _view(agent, times),
        "received_by": received_by,
        "not_received_by": not_received_by,
        "receives_ground": None if agent.no_ground is None else not agent.no_ground,
        "swarm_says": level.name if level not in (None, Level.STALE) else None,
        "autopilot": autopilot_fields(autopilot, now, times) if autopilot is not None else None,
        "on_hold": agent.on_hold,
        "restarts": agent.restarts,
        "late": agent.late,
        "problem": agent.problem or None,
        "first_utc": iso(agent.first.utc) if agent.first else None,
        "last_utc": iso(agent.last.utc) if agent.last else None,
    }


def _line(agent: Agent, times: Times) -> dict[str, Any] | None:
    received = agent.last_text
    if received is None:
        return None
    age = times.of(received.at.mono)
    return {"text": received.text, "severity": received.severity, **age, "via": received.via or None}


def _bad(agent: Agent, times: Times) -> list[dict[str, Any]]:
    return [
        {"slot": slot, "level": bad.level.name, "text": bad.text, **times.of(bad.at.mono)}
        for slot, units in sorted(agent.bad.items())
        for bad in units.values()
    ]


def _advice(agent: Agent, times: Times) -> list[dict[str, Any]]:
    return [
        {
            "fault": one.fault,
            "slot": one.slot,
            "action": one.action,
            "target": one.target,
            "valid_s": one.valid_s,
            **times.of(one.at.mono),
        }
        for one in agent.advice.values()
    ]


def _view(agent: Agent, times: Times) -> dict[str, Any] | None:
    if agent.view is None or agent.view_at is None:
        return None
    return {**view(agent.view), **times.of(agent.view_at.mono)}


def _swarm(swarm: SwarmState, times: Times) -> dict[str, Any] | None:
    if swarm.digest is None and not swarm.line:
        return None
    ages = {
        **times.of(swarm.line_at.mono if swarm.line_at else None, "line_"),
        **times.of(swarm.digest_at.mono if swarm.digest_at else None, "digest_"),
    }
    body = digest(swarm.digest) if swarm.digest is not None else {"members": None, "alive": None, "levels": {}}
    by = swarm.line_by or swarm.digest_by
    return {"by": by, "line": swarm.line or None, **body, **ages}
