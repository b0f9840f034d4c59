"""The row of an agent as the page shows it: that of a snapshot, and what follows from it. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phm.core.model import Level, Slot

Json = dict[str, Any]
RANKS = ("ERROR", "LOST", "WARN", "UNKNOWN", "STALE", "HOLD", "BOOT", "LEFT", "OK")
"""States of an agent, the worst first, as in the table of the terminal."""
HOPS = ("ground", "radio", "computer", "container", "node", "autopilot")
"""The hops on the path of a command."""
_PLACES = {
    "ground link": "ground",
    "GCS": "ground",
    "radio": "radio",
    "radio or vehicle": "radio",
    "link": "radio",
    "port": "radio",
    "router": "computer",
    "companion": "computer",
    "application": "container",
    "autopilot": "autopilot",
}
"""The hop on the page for each name of a broken hop."""
_SLOT_OF = {"container": Slot.CONTAINER, "node": Slot.NODES, "autopilot": Slot.AUTOPILOT, "radio": Slot.RADIO}
_STATES = {Level.OK.name: "ok", Level.WARN.name: "ok", Level.ERROR.name: "broken"}


def row(agent: Mapping[str, Any], **more: Any) -> Json:
    """The row of an agent. agent: its part of a snapshot with moments. more: keys that only the page has."""
    how = str(agent["how"])
    rank = RANKS.index(how) if how in RANKS else 0
    found = {"rank": rank, "checks": None, **agent, "hops": path(agent), **more}
    found.pop("last_utc", None)  # `at` says it, and changes with each heartbeat as well
    return found


def path(agent: Mapping[str, Any]) -> list[Json]:
    """The hops of a command from the ground to the autopilot: ok, broken, perhaps (broken) or unknown, with the reason in words."""
    there = agent["presence"] in ("alive", "late")
    hop = agent["hop"]
    found = [_hop(name, agent, there=there) for name in HOPS]
    if hop is not None:
        place = HOPS.index(_place(str(hop["name"]), agent))
        found[place].update(state="broken" if hop["certain"] else "perhaps", text=f"{hop['name']}: {hop['evidence']}")
        if not there:
            for later in found[place + 1 :]:
                later.update(state="unknown", text="")
            for earlier in found[:place]:
                earlier.update(state="ok", text="")
    autopilot = agent["autopilot"]
    if autopilot is not None and autopilot["presence"] in ("alive", "late") and found[-1]["state"] == "unknown":
        found[-1].update(state="ok", text="received by the ground")
    return found


def _hop(name: str, agent: Mapping[str, Any], *, there: bool) -> Json:
    if not there:
        return {"name": name, "state": "unknown", "text": ""}
    if name in ("ground", "computer"):
        return {"name": name, "state": "ok", "text": ""}
    slot = _SLOT_OF[name]
    level = agent["slots"].get(str(int(slot)))
    state = _STATES.get(str(level), "ok" if name == "radio" else "unknown")
    texts = [bad["text"] for bad in agent["bad"] if bad["slot"] == slot]
    return {"name": name, "state": state, "text": texts[0] if texts else ""}


def _place(name: str, agent: Mapping[str, Any]) -> str:
    if name == "application":
        container = agent["slots"].get(str(int(Slot.CONTAINER))) == Level.ERROR.name
        return "container" if container else "node"
    return _PLACES.get(name) or _PLACES.get(name.partition(" ")[0]) or "computer"
