"""The one type that every source yields: a line of a record with the keys that a report uses."""

from __future__ import annotations

from typing import Any

import msgspec

Number = int | float
WORDS = {"FAIL": "ERROR", "WARN": "WARN"}
"""Of PHM's lines about a change, and their levels."""
LATEST_S = 1e11
"""UTC seconds that no clock of a record exceeds."""


class Event(msgspec.Struct, gc=False):
    """Keys as in `docs/reference/logs.md` (with `boot_id`) and `docs/reference/gcs.md` (with `run`).

    A source of other records sets `agent`, `event`, `utc_s` and what it knows of the rest. mono: 0 where the record has no
    monotonic clock. placed: False: `utc_s` counts from an arbitrary moment, as the record does not say when it was made.
    """

    event: str
    agent: str | int | None = ""
    agent_id: int = 0
    boot_id: str = ""
    run: str = ""
    seq: int = 0
    mono: float = 0.0
    utc_s: float = 0.0
    kind: str = ""
    unit: str = ""
    check: str = ""
    slot: int | None = None
    layer: str = ""
    level: str = ""
    old: str = ""
    changed_text: bool = False
    summary: str = ""
    brief: str = ""
    condition: str = ""
    target: str | None = ""
    blocked_by: str = ""
    fault: str | int | None = ""
    values: msgspec.Raw = msgspec.Raw()
    duration_s: float | None = None
    duration_ms: float | None = None
    outcome: str = ""
    by: Any = ""
    blocks: list[str] = []
    consequences: list[str] = []
    suspects: list[str] = []
    action: str = ""
    phase: str = ""
    attempt: int = 1
    detail: str = ""
    text: str = ""
    number: int = 0
    began: bool = False
    placed: bool = True
    continued: bool = False
    reason: str = ""
    version: str = ""
    machine_boot: str = ""
    interval_s: float = 0.0
    took_s: float = 0.0
    lines: int = 0
    cpu_s: float | None = None
    memory_bytes: int = 0
    sent_bytes: dict[str, int] = {}
    frames: list[tuple[int, int, int, float]] = []
    # of the ground alone
    name: str | None = ""
    system: int | None = None
    component: int | None = None
    link: str | None = ""
    presence: str = ""
    silent_s: float | None = None
    age_s: float | None = None
    armed: bool | None = None
    word: str | int | None = None
    changed: msgspec.Raw = msgspec.Raw()
    slots: msgspec.Raw = msgspec.Raw()
    radios: msgspec.Raw = msgspec.Raw()
    phm: bool = False
    repeat: bool = False


LONG_LINE, MOST_TEXT = 8000, 1000
"""Bytes of a line, characters of a text. PHM writes no longer line of an event with long texts, so a longer one is from anyone."""
_TEXTS = tuple(name for name, kind in Event.__annotations__.items() if kind.startswith(("str", "Any")))
_LISTS = tuple(name for name, kind in Event.__annotations__.items() if kind == "list[str]")
_DECODER = msgspec.json.Decoder(Event)
_LOOSE = msgspec.json.Decoder(dict[str, Any])
UNREADABLE = (msgspec.DecodeError, RecursionError, UnicodeDecodeError, ValueError)


def parse(line: bytes) -> tuple[Event | None, str]:
    """The event of one line, and what is wrong with the line in words; empty: nothing."""
    try:
        event, wrong = _DECODER.decode(line), ""
    except msgspec.ValidationError:
        return _without_wrong_types(line)
    except UNREADABLE:
        return None, "not JSON, incomplete or nested too deeply"
    if not (0.0 <= event.mono < LATEST_S and 0.0 < event.utc_s < LATEST_S):
        return None, "no possible time"
    if len(line) > LONG_LINE:
        _cut(event)
    return event, wrong


def _without_wrong_types(line: bytes) -> tuple[Event | None, str]:
    """A damaged line still says what its other keys say."""
    try:
        loose = _LOOSE.decode(line)
    except UNREADABLE:
        return None, "not a JSON object"
    kept: dict[str, Any] = {}
    for key, value in loose.items():
        try:
            msgspec.json.decode(msgspec.json.encode({"event": "", key: value}), type=Event)
            kept[key] = value
        except UNREADABLE:
            continue
    try:
        event = msgspec.json.decode(msgspec.json.encode(kept), type=Event)
    except UNREADABLE:
        return None, "without the key event"
    if not (0.0 <= event.mono < LATEST_S and 0.0 < event.utc_s < LATEST_S):
        return None, "no possible time"
    _cut(event)
    return event, "a key of the wrong type, which was left out"


def _cut(event: Event) -> None:
    """Thousands of texts of a megabyte each would be kept otherwise."""
    for name in _TEXTS:
        value = getattr(event, name)
        if value is not None and not isinstance(value, int):
            setattr(event, name, str(value)[:MOST_TEXT])
    for name in _LISTS:
        setattr(event, name, [text[:MOST_TEXT] for text in getattr(event, name)])
    if len(event.values) > LONG_LINE:
        event.values = msgspec.Raw()


def numbers(raw: msgspec.Raw) -> dict[str, Number | str | bool | None]:
    """The `values` of a unit; empty if it has none."""
    try:
        found = msgspec.json.decode(raw, type=dict[str, int | float | str | bool | None]) if raw else {}
    except UNREADABLE:
        return {}
    return found
