"""Faults with their timelines, built from the JSON log (`phm.wire.json_log`) and the status file.

Standard library only. The log is the record of what happened; the status file says what is open now.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from phm.wire.shape import mismatch

Json = dict[str, Any]
MAX_EPISODES = 5000
MAX_STEPS = 200
MAX_BLOCKS = 50
MAX_TEXT = 1000
_TEXTS = (
    "event",
    "fault",
    "unit",
    "layer",
    "condition",
    "summary",
    "brief",
    "target",
    "opened",
    "closed",
    "utc",
    "outcome",
    "by",
    "action",
    "phase",
    "detail",
    "blocked_by",
)
SHAPES: dict[str, Any] = {
    **dict.fromkeys(_TEXTS, (str, type(None))),
    "slot": int,
    "duration_s": (float, type(None)),
    "blocks": [str],
    "consequences": [str],
    "suspects": [str],
}
"""The keys that an episode is made of, and their types."""


def build_timelines(events: Iterable[Mapping[str, Any]], open_now: Sequence[Mapping[str, Any]] | None) -> list[Json]:
    """Every fault, oldest first: the keys of the log's `fault_opened` with `timeline`, a list of ``{utc, what, text}``.

    open_now: the faults of a daemon that runs, open or given up, or None when none does: those are ``current`` and say what is
    wrong now. With it, a fault that the log leaves open and the daemon does not know has the outcome ``unknown``: PHM ended and
    its state was lost.
    """
    episodes: dict[str, Json] = {}
    by_unit: dict[str, str] = {}
    for event in map(_sound, events):
        kind, name = event.get("event"), event.get("fault")
        if kind == "transition" and event.get("blocked_by"):
            _blocked(episodes.get(by_unit.get(str(event["blocked_by"]), "")), event)
        elif isinstance(name, str) and name and kind in ("fault_opened", "fault_closed", "action"):
            episode = episodes.setdefault(name, _new(event))
            _take(episode, event)
            if kind == "fault_opened":
                by_unit[episode["unit"]] = name
            if len(episodes) > MAX_EPISODES:
                del episodes[next(iter(episodes))]
    known = {str(fault.get("fault")): fault for fault in map(_sound, open_now or ())}
    for name, fault in known.items():
        if name not in episodes:  # its opening is in a log that is gone
            episodes[name] = {**_new(fault), **fault}
            _step(episodes[name], fault.get("opened"), "opened", fault.get("summary"))
        now = {key: fault[key] for key in ("summary", "brief", "condition", "target") if fault.get(key) is not None}
        episodes[name].update(now, current=True)
    for name, episode in episodes.items():
        if open_now is not None and episode["outcome"] == "open" and name not in known:
            episode["outcome"] = "unknown"
    return sorted(episodes.values(), key=lambda episode: str(episode["opened"]))


def _sound(event: Mapping[str, Any]) -> Json:
    """The event without what has the wrong type, and with texts of a sound length: a damaged line still says what its other keys say."""
    return {key: _short(value) for key, value in event.items() if key in SHAPES and not mismatch(value, SHAPES[key])}


def _short(value: Any) -> Any:
    if isinstance(value, list):
        return [text[:MAX_TEXT] for text in value[:MAX_BLOCKS]]
    return value[:MAX_TEXT] if isinstance(value, str) else value


def _new(event: Mapping[str, Any]) -> Json:
    keys = (
        "fault",
        "unit",
        "slot",
        "layer",
        "condition",
        "summary",
        "brief",
        "target",
        "opened",
        "closed",
        "duration_s",
    )
    filled = {key: event.get(key) for key in keys}
    filled["opened"] = event.get("opened") or event.get("utc")
    return {**filled, "outcome": "open", "by": "", "blocks": [], "timeline": [], "current": False}


def _take(episode: Json, event: Mapping[str, Any]) -> None:
    kind, when = event["event"], event.get("utc")
    if kind == "action":
        text = str(event.get("detail") or f"{event.get('action')} {event.get('target')}")
        _step(episode, when, f"{event.get('action')} {event.get('phase')}", text)
        return
    episode.update({key: event[key] for key in ("summary", "brief", "condition", "target", "opened") if key in event})
    if kind == "fault_opened":
        _step(episode, when, "opened", event.get("summary"))
        return
    episode.update({key: event.get(key) for key in ("closed", "duration_s", "outcome", "by")})
    _blocks(episode, event.get("blocks"))
    _step(episode, when, str(event.get("outcome")), _ending(event))


def _ending(event: Mapping[str, Any]) -> str:
    by = event.get("by")
    took = f"after {event.get('duration_s')} s"
    if event.get("outcome") == "reattributed":
        return f"follows from {by}, {took}"
    who = "by itself" if by in ("", "itself", None) else f"by {by}"
    return f"{who} {took}" if event.get("outcome") == "resolved" else took


def _blocked(episode: Json | None, event: Mapping[str, Any]) -> None:
    if episode is not None and episode["outcome"] == "open" and event.get("unit") not in episode["blocks"]:
        _blocks(episode, [event.get("unit")])
        _step(episode, event.get("utc"), "blocks", event.get("unit"))


def _blocks(episode: Json, units: Any) -> None:
    for unit in units if isinstance(units, list) else ():
        if isinstance(unit, str) and unit not in episode["blocks"] and len(episode["blocks"]) < MAX_BLOCKS:
            episode["blocks"].append(unit)


def _step(episode: Json, utc: object, what: str, text: object) -> None:
    if len(episode["timeline"]) < MAX_STEPS:
        episode["timeline"].append({"utc": utc, "what": what, "text": "" if text is None else str(text)})
