"""A line of the record in words: what happened, and below it cause, consequence, action and remedy.

The words are those of the record (`summary`, `detail`, `values`); nothing is judged here again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from shlex import quote
from typing import Any

from phm.core.duplicate_filter import DuplicateFilter
from phm.logs.line_filter import number
from phm.wire.report import with_hertz
from phm.wire.text import one_line

Json = Mapping[str, Any]

MOST_TEXT = 2000
MOST_ITEMS = 8
_REMEMBERED = 256
_MEANING = {
    "advised": "PHM waits for an operator",
    "expired": "no one approved it in time",
    "refused": "the operator's request was not carried out",
    "failed": "the action failed",
    "escalated": "PHM has given up",
}


@dataclass(frozen=True)
class Words:
    """when: UTC. details: pairs of a label and a text."""

    when: str
    agent: str
    kind: str
    text: str
    details: tuple[tuple[str, str], ...] = ()


class Explainer:
    """Explains lines; remembers open faults, so that an explanation is not repeated."""

    def __init__(self) -> None:
        self._faults: DuplicateFilter[tuple[str, str], str] = DuplicateFilter(_REMEMBERED)
        self._last: DuplicateFilter[tuple[str, str], int] = DuplicateFilter(_REMEMBERED)

    def explain(self, event: Json, options: str = "") -> Words:
        """A line in words. The text is empty if the line before has reported the fault that this transition opened.

        options: what `phm faults` needs to find this log.
        """
        name, made = event.get("event"), words(event, options)
        said = (_text(event, "agent"), _text(event, "fault"))
        if name == "fault_opened":
            self._faults.add(said, _text(event, "summary"))
        elif name == "transition" and said[1] and self._faults.get(said) == _text(event, "summary"):
            values = tuple(detail for detail in made.details if detail[0] == "values")
            return replace(made, text="", details=values)
        return made

    def gap(self, event: Json) -> int:
        """The number of missing lines before this one, by the numbers of the lines."""
        seq, run = event.get("seq"), (_text(event, "agent"), _text(event, "boot_id"))
        if not isinstance(seq, int):
            return 0
        before = self._last.get(run)
        self._last.add(run, seq)
        if before is None or event.get("event") == "lost":
            return 0
        return max(0, seq - before - 1)


def words(event: Json, options: str = "") -> Words:
    """A line of a log in words. Every text is safe to print and bounded. options: as for `Explainer.explain`."""
    when = _text(event, "utc")[:24].removesuffix("Z").replace("T", " ", 1)
    slot = event.get("slot")
    place = f"({slot}) " if isinstance(slot, int) else ""
    details = tuple((label, text) for label, text in _details(event, options) if text)
    return Words(when, _text(event, "agent")[:64], _text(event, "kind")[:16] or "?", place + _said(event), details)


def _said(event: Json) -> str:
    name, unit = event.get("event"), _text(event, "unit")
    if name in ("transition", "unit", "fault_opened"):
        return f"{unit}: {with_hertz(event, _text(event, 'summary'))}{_was(event)}"
    if name == "fault_closed":
        by, lasted = _text(event, "by"), event.get("duration_s")
        after = f" after {number(lasted):.1f} s" if isinstance(lasted, (int, float)) else ""
        return f"{unit}: {_text(event, 'outcome')}{f' by {by}' if by else ''}{after}"
    if name == "action":
        return f"{unit}: {_text(event, 'action')} {_text(event, 'phase')}: {_text(event, 'detail')}"
    if name == "start":
        return f"PHM {_text(event, 'version')} started, process {_text(event, 'pid')}"
    if name == "report_started":
        return f"report {_text(event, 'number')} started"
    if name == "report":
        return f"report {_text(event, 'number')}: {_text(event, 'successes')} OK, {_text(event, 'failures')} failed"
    if name == "lost":
        return f"{_text(event, 'lines')} lines before this one were lost: {_text(event, 'reason')}"
    return _text(event, "text") or _text(event, "event")


def _was(event: Json) -> str:
    return "" if event.get("event") != "transition" or event.get("changed_text") else f" (was {_text(event, 'old')})"


def _details(event: Json, options: str) -> Iterator[tuple[str, str]]:
    name, fault = event.get("event"), _text(event, "fault")
    timeline = f"phm faults {quote(fault)}{options}" if fault else ""  # to be copied, from a file of anyone
    if name in ("transition", "unit"):
        blocker = _text(event, "blocked_by")
        cause = f"blocked by {blocker}" if blocker else _condition(event)
        yield "cause", "" if cause in _text(event, "summary") else cause
        if event.get("level") not in ("OK", "n/a"):
            yield "values", _values(event.get("values"))
            yield "see", timeline
    elif name == "fault_opened":
        yield "cause", _condition(event)
        yield "possible cause", _list(event.get("suspects"))
        yield "blocks", _list(event.get("consequences")) or _list(event.get("blocks"))
        yield "see", timeline
    elif name == "fault_closed":
        yield "had blocked", _list(event.get("blocks"))
        yield "see", timeline if event.get("outcome") == "escalated" else ""
    elif name == "action":
        phase = _text(event, "phase")
        yield "means", _MEANING.get(phase, "")
        where = f" (on {quote(_text(event, 'agent'))})" if options else ""
        yield "remedy", f"phm approve {quote(fault)}{where}" if phase == "advised" and fault else ""
        yield "see", timeline if phase in ("failed", "escalated") else ""


def _condition(event: Json) -> str:
    condition, target = _text(event, "condition"), _text(event, "target")
    return f"{condition.replace('_', ' ')}{f' in {target}' if target else ''}" if condition else ""


def _values(values: object) -> str:
    if not isinstance(values, dict):
        return ""
    known = {key: value for key, value in values.items() if value is not None}
    listed = [f"{key}: {_plain(value)}" for key, value in list(known.items())[:MOST_ITEMS]]
    more = [f"and {len(known) - MOST_ITEMS} more"] if len(known) > MOST_ITEMS else []
    return _safe(", ".join([*listed, *more]))


def _list(value: object) -> str:
    if not isinstance(value, list):
        return ""
    more = [f"and {len(value) - MOST_ITEMS} more"] if len(value) > MOST_ITEMS else []
    return _safe(", ".join([*(_plain(each) for each in value[:MOST_ITEMS]), *more]))


def _text(event: Json, key: str) -> str:
    value = event.get(key)
    return "" if value is None or isinstance(value, (dict, list)) else _plain(value)


def _plain(value: object) -> str:
    return _safe(value if isinstance(value, str) else str(value)[:MOST_TEXT])


def _safe(text: str) -> str:
    return one_line(text if len(text) <= MOST_TEXT else text[: MOST_TEXT - 1] + "…")
