"""The row of one agent as the page shows it, made from the agent's own status file. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timezone
from typing import Any

from phm import __version__
from phm.core.model import Level, Slot
from phm.gcs.agent import PHM_COMPONENT
from phm.gcs.snapshot import UNKNOWN
from phm.gcs.web import rows
from phm.wire.status_line import agent_name
from phm.wire.text import one_line

Json = dict[str, Any]
SLOTS = {str(int(slot)): slot.short for slot in Slot}
PERIOD_S = 2.0
"""The daemon writes its status this often (`phm.reporters.status`)."""
MAX_TEXT = 500
_RANK = {level.name: level.severity for level in Level}
_ALIVE, _LOST, _NEVER = "alive", "lost", "never received"


def ground(document: Mapping[str, Any], problem: str) -> Json:
    """What is not about the agent: there is no ground. document: as `phm.wire.status_shape.read` returns it, or empty. problem: why
    the daemon is not healthy, or empty."""
    return {
        "page": "status",
        "version": __version__,
        "system": _number(document.get("agent_id")),
        "component": PHM_COMPONENT,
        "links": [],
        "radios": [],
        "stations": [],
        "swarm": None,
        "problems": [text(line) for line in (problem, *_problems(document)) if line],
        "refused": 0,
        "frames_refused": 0,
        "slots": SLOTS,
        "silent": True,
        "rate": 1,
        "replay": None,
        "history": None,
    }


def name(document: Mapping[str, Any]) -> str:
    """As the ground calls it, such as A07; PHM without a status."""
    number = _number(document.get("agent_id"))
    return agent_name(number) if number else "PHM"


def row(document: Mapping[str, Any], problem: str) -> Json:
    """The row. Its moments are monotonic seconds of this machine, on which the daemon runs as well."""
    healthy, there = not problem, bool(document)
    written = finite(document.get("written_mono"))
    units = [_unit(one, document) for one in document.get("checks", ())]
    bad = [one for one in units if one["level"] in (Level.WARN.name, Level.ERROR.name)]
    worst = _worst(units)
    found = {
        "agent": _number(document.get("agent_id")),
        "name": name(document),
        "component": PHM_COMPONENT,
        "link": None,
        "how": _how(worst, document) if healthy else "LOST" if there else UNKNOWN,
        "presence": _ALIVE if healthy else _LOST if there else _NEVER,
        "at": None if written is None else round(written, 2),
        "period_s": PERIOD_S,
        "word": document.get("status_word"),
        "state": None,
        "slots": _slots(units) if healthy else {},
        "last_slots": _slots(units),
        "hop": None,
        "line": None,
        "bad": [{key: one[key] for key in ("slot", "level", "text", "at")} for one in bad] if healthy else [],
        "advice": [],
        "containers": [],
        "view": None,
        "received_by": [],
        "not_received_by": [],
        "receives_ground": None,
        "swarm_says": None,
        "autopilot": None,
        "on_hold": bool(document.get("holds")),
        "restarts": 0,
        "problem": text(problem) or None,
        "first_utc": None,
    }
    made = rows.row(found, alarm=None, values={}, checks=units)
    return {**made, "hops": [_hop(hop, units) for hop in made["hops"]]}


def _hop(hop: Json, units: list[Json]) -> Json:
    """As drawn for the ground, which has received a heartbeat; the agent itself knows of ground and radio only what it receives."""
    unit = {"ground": "gcs", "radio": "radio"}.get(hop["name"])
    if unit is None or hop["state"] == "broken":
        return hop
    ok = any(one["level"] == "OK" and one["unit"].partition("/")[0] == unit for one in units)
    return {**hop, "state": "ok" if ok and hop["state"] == "ok" else "unknown"}


def text(words: object) -> str:
    """One line of bounded length: what a check says may come from anywhere."""
    return one_line(str(words))[:MAX_TEXT]


def _how(worst: str, document: Mapping[str, Any]) -> str:
    if document.get("holds") and worst in ("OK", Level.STALE.name):
        return "HOLD"
    return worst


def _worst(units: list[Json]) -> str:
    levels = [one["level"] for one in units if one["level"] in _RANK]
    return max(levels, key=_RANK.__getitem__, default=UNKNOWN)


def _slots(units: list[Json]) -> dict[str, str]:
    """The worst level of each slot that is used."""
    found: dict[int, list[Json]] = {}
    for one in units:
        if one["level"] in _RANK:
            found.setdefault(one["slot"], []).append(one)
    return {str(slot): _worst(found[slot]) for slot in sorted(found)}


def _unit(one: Mapping[str, Any], document: Mapping[str, Any]) -> Json:
    blocked = f" (blocked by {one['blocked_by']})" if one["blocked_by"] else ""
    return {
        "layer": text(one.get("layer", "")),
        "slot": one["slot"],
        "unit": text(one["id"]),
        "level": text(one["level"]),
        "text": text(f"{one['summary']}{blocked}"),
        "at": _moment(one.get("since"), document),
    }


def _moment(since: object, document: Mapping[str, Any]) -> float | None:
    """UTC of the document as monotonic seconds, whole ones: both clocks are read a moment apart in each document."""
    written, begun = finite(document.get("written_mono")), utc_seconds(since)
    at = utc_seconds(document.get("written_utc"))
    return None if written is None or begun is None or at is None else float(round(written - (at - begun)))


def utc_seconds(moment: object) -> float | None:
    """UTC seconds of a moment as PHM writes it; None for anything else."""
    try:
        return datetime.strptime(str(moment), "%Y-%m-%dT%H:%M:%S.%fZ").replace(tzinfo=timezone.utc).timestamp()
    except (ValueError, OverflowError):
        return None


def _problems(document: Mapping[str, Any]) -> list[str]:
    health = document.get("health")
    return list(health.get("problems", ())) if isinstance(health, dict) else []


def _number(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 255 else 0


def finite(value: object) -> float | None:
    """The number, None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        seconds = float(value)
    except OverflowError:
        return None
    return seconds if math.isfinite(seconds) else None
