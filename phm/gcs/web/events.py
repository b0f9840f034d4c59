"""Events of the station as the page and the history have them. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from phm.core.model import Stamp
from phm.gcs.agent import PHM_COMPONENT
from phm.gcs.alarms import CRITICAL
from phm.gcs.events import GcsEvent, describe
from phm.wire.status_line import agent_name

Json = dict[str, Any]
GRADES = ("info", "ok", "warn", "error", "critical")
"""Grades of an event, from harmless to critical."""
_HEAD = frozenset(("v", "run", "seq", "utc", "utc_s", "mono", "event"))
_LEVELS = {"OK": "ok", "WARN": "warn", "ERROR": "error"}


def from_line(line: bytes | Mapping[str, Any]) -> Json:
    """A line of `docs/reference/gcs.md` with `words`, `who` and `grade`. Raises KeyError, TypeError and ValueError for another
    line."""
    head: Mapping[str, Any] = json.loads(line) if isinstance(line, bytes) else line
    body = {key: value for key, value in head.items() if key not in _HEAD}
    event = GcsEvent(Stamp(float(head["utc_s"]), float(head["mono"])), str(head["event"]), body)
    kept = {key: value for key, value in head.items() if key not in ("v", "run")}
    return {**kept, "words": describe(event), "who": who(event), "grade": grade(event)}


def who(event: GcsEvent) -> str:
    """Name of the agent that the event is about; empty: it is about none."""
    body = event.body
    if "name" in body:
        return str(body["name"])
    if event.event == "autopilot":
        return agent_name(int(body["system"]))
    if event.event != "text":
        return ""
    number, component = int(body.get("agent") or body.get("system") or 0), body.get("component", PHM_COMPONENT)
    if not 1 <= number <= 250 or (not body["phm"] and component != PHM_COMPONENT):
        return agent_name(number) if 1 <= number <= 250 else ""
    relayed = number != body.get("system")
    return agent_name(number) + ("" if component == PHM_COMPONENT or relayed else f"/{component}")


def grade(event: GcsEvent) -> str:
    """How severe the event is: one of GRADES."""
    body = event.body
    match event.event:
        case "text":
            return _of_severity(int(body["severity"]), str(body.get("word") or ""))
        case "presence":
            return {"lost": "error", "alive": "ok"}.get(str(body["presence"]), "info")
        case "slots":
            levels = [pair[1] for pair in dict(body["changed"]).values()]
            return max((_LEVELS.get(str(level), "info") for level in levels), key=GRADES.index, default="info")
        case "hop":
            return "ok" if body["hop"] is None else "error"
        case "autopilot":
            return "error" if body["presence"] == "lost" else "info"
        case "link":
            return "ok" if body["open"] else "error"
        case "problem" | "lost" | "restart":
            return "warn"
        case _:
            return "info"


def _of_severity(severity: int, word: str) -> str:
    if severity <= CRITICAL:
        return "critical"
    if severity == CRITICAL + 1:
        return "error"
    if severity == CRITICAL + 2:
        return "warn"
    return "ok" if word == "OK" else "info"
