"""Events of the ground station, as a line of JSON for programs and a line of text for people. Pure.

The keys of the JSON lines are a contract: `docs/reference/gcs.md`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from phm.core.model import Stamp
from phm.wire.report import clock_text, iso
from phm.wire.status_line import agent_name

VERSION = 2
"""`v` of the lines. It is raised only when a key changes its meaning or is removed."""
SEVERITIES = ("EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING", "NOTICE", "INFO", "DEBUG")

_BAD = frozenset(("WARN", "ERROR"))
_QUIET = {"OK": "OK", "STALE": "unknown"}


@dataclass(frozen=True, slots=True)
class GcsEvent:
    """at: when it was received, by the ground's clocks. body: JSON-able."""

    at: Stamp
    event: str
    body: Mapping[str, Any]


def encode(event: GcsEvent, run: str, number: int) -> bytes:
    """One line of JSON, without its end. run: id of this run; number: counts its events from 1."""
    when = {"utc": iso(event.at.utc), "utc_s": round(event.at.utc, 6), "mono": round(event.at.mono, 6)}
    whole = {"v": VERSION, "run": run, "seq": number, **when, "event": event.event, **event.body}
    return json.dumps(whole, separators=(",", ":"), allow_nan=False, default=str).encode("ascii")


def severity_name(severity: int) -> str:
    """The name of a MAVLink severity; a number outside of 0 to 7 is returned as text."""
    return SEVERITIES[severity] if 0 <= severity < len(SEVERITIES) else str(severity)


def describe(event: GcsEvent) -> str:
    """Text for people, without the time; empty for a repetition."""
    describe_body = _WORDS.get(event.event)
    return describe_body(event.body) if describe_body is not None else ""


def describe_with_time(event: GcsEvent) -> str:
    """`describe` with the UTC time before it; empty if that is."""
    said = describe(event)
    return f"{clock_text(event.at.utc)} {said}" if said else ""


def _text(body: Mapping[str, Any]) -> str:
    if body["repeat"]:
        return ""
    who = "" if body["phm"] else f"{body['system']}/{body['component']} "
    return f"{severity_name(body['severity']):8} {who}{body['text']}"


def _slots(body: Mapping[str, Any]) -> str:
    """Slots that fail or failed one by one; the number of the others."""
    changed = dict(body["changed"])
    notable = {slot: pair for slot, pair in changed.items() if _BAD.intersection(pair)}
    pieces = [f"slot {slot} {old} -> {new}" for slot, (old, new) in notable.items()]
    quiet = [new for slot, (_, new) in changed.items() if slot not in notable]
    pieces += [_became(quiet.count(level), word) for level, word in _QUIET.items() if level in quiet]
    return ", ".join([f"{_name(body)} {body['state']}", *pieces])


def _became(count: int, word: str) -> str:
    return f"1 slot becomes {word}" if count == 1 else f"{count} slots become {word}"


def _presence(body: Mapping[str, Any]) -> str:
    silent = f", silent for {body['silent_s']:g} s" if body["presence"] == "lost" and body["silent_s"] else ""
    return f"{_name(body)} is {body['presence']}{silent}"


def _hop(body: Mapping[str, Any]) -> str:
    hop = body["hop"]
    if hop is None:
        return f"{_name(body)} no broken hop detected"
    return f"{_name(body)} {'broken' if hop['certain'] else 'possibly broken'} at {hop['name']}: {hop['evidence']}"


def _autopilot(body: Mapping[str, Any]) -> str:
    how = "armed" if body["armed"] else "disarmed"
    return f"autopilot {body['system']} is {body['presence']}, {how}, mode {body['mode']}"


def _link(body: Mapping[str, Any]) -> str:
    return f"link {body['link']} is {'open' if body['open'] else 'closed: ' + body['error']}"


def _digest(body: Mapping[str, Any]) -> str:
    not_ok = ", ".join(f"{agent_name(int(agent))} {level}" for agent, level in body["levels"].items() if level != "OK")
    return (
        f"swarm: {body['alive']} of {body['members']} alive{', ' if not_ok else ''}{not_ok}" if body["changed"] else ""
    )


def _result(body: Mapping[str, Any]) -> str:
    return f"answers command {body['command']}: {body['result'].lower().replace('_', ' ')}"


def _name(body: Mapping[str, Any]) -> str:
    return str(body["name"])


_WORDS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "text": _text,
    "slots": _slots,
    "presence": _presence,
    "hop": _hop,
    "autopilot": _autopilot,
    "link": _link,
    "digest": _digest,
    "agent": lambda body: f"{_name(body)} discovered, {body['system']}/{body['component']} on {body['link']}",
    "restart": lambda body: f"{_name(body)} PHM restarted or reloaded",
    "detail": lambda body: f"{_name(body)} fault {body['fault']}: {body['text']}",
    "ack": lambda body: f"{_name(body)} {_result(body)}",
    "problem": lambda body: f"problem: {body['text']}",
    "start": lambda body: (
        f"phm gcs {body['version']} as {body['system']}/{body['component']} on {', '.join(body['links'])}"
    ),
}
