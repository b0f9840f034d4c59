"""Faults of all agents with their timelines, from the lines that the ground receives. Pure.

An agent reports a fault when it is confirmed, and its end with what ended it. When it was detected is in the details of the fault,
which the operator can request.
"""

from __future__ import annotations

import re
from collections import OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

from phm.gcs import statustext_parser
from phm.gcs.statustext_parser import LineKind, ParsedLine

Json = dict[str, Any]
MAX_OPEN, MAX_STEPS, MAX_QUIET = 2000, 40, 200
LINE_S = 60.0
"""Seconds by which the line about an end may follow the heartbeat that shows this end."""
BY_HEARTBEAT, BY_REFRESH = "by its heartbeat", "by its refresh"
_SINCE = re.compile(r"since ([0-9]{2}):([0-9]{2}):([0-9]{2}) UTC")
_ENDED = re.compile(r"(?:cleared|recovered): |\S+ recovered$")
_VALUE = re.compile(r"(?<!\S)[0-9.]+ ?(?=(?:%|ms|s|Hz|kB|MB|GB|C|V)(?!\S))")
"""A measured value: it is followed by its unit. Other numbers name something."""
DAY_S = 86_400.0


@dataclass(slots=True)
class FaultEntry:
    """key: unique in the history. number: as in `#17`, None: not known. ended: UTC seconds; None: it is open."""

    key: str
    who: str
    slot: int
    text: str
    level: str
    at: float
    number: int | None = None
    ended: float | None = None
    steps: list[Json] = field(default_factory=list)

    @property
    def open(self) -> bool:
        return self.ended is None

    def step(self, name: str, utc_s: float, text: str, **more: object) -> None:
        """more: what `as_of` needs: `level`, from this step on, and `known_utc_s`, when the ground received it, if that is later."""
        if len(self.steps) < MAX_STEPS:
            self.steps.append({"step": name, "utc_s": round(utc_s, 3), "text": text, **more})
            self.steps.sort(key=lambda one: float(one["utc_s"]))

    def json(self) -> Json:
        return {
            "key": self.key,
            "agent": self.who,
            "slot": self.slot,
            "unit": self.text.split(" ")[0],
            "text": self.text,
            "level": self.level,
            "number": self.number,
            "open": self.open,
            "utc_s": round(self.at, 3),
            "ended_utc_s": None if self.ended is None else round(self.ended, 3),
            "steps": self.steps,
        }


def from_json(body: Mapping[str, Any]) -> FaultEntry:
    """The entry of a stored object. Raises KeyError, TypeError and ValueError for another object."""
    return FaultEntry(
        str(body["key"]),
        str(body["agent"]),
        int(body["slot"]),
        str(body["text"]),
        str(body["level"]),
        float(body["utc_s"]),
        body["number"],
        body.get("ended_utc_s"),
        [{**step, "utc_s": float(step["utc_s"])} for step in list(body["steps"])[:MAX_STEPS]],
    )


def as_of(body: Mapping[str, Any], until: float) -> Json:
    """The stored object as it was known at a moment."""
    steps = [step for step in body["steps"] if step.get("known_utc_s", step["utc_s"]) <= until]
    level = next((step["level"] for step in reversed(steps) if "level" in step), body["level"])
    ended = body["ended_utc_s"] if body["ended_utc_s"] is not None and body["ended_utc_s"] <= until else None
    return {**body, "steps": steps, "level": level, "open": ended is None, "ended_utc_s": ended}


class FaultList:
    """Holds the open faults. `take` returns those that have changed."""

    def __init__(self, known: Iterable[FaultEntry] = ()) -> None:
        """known: the faults that were open when the ground stopped."""
        self._open: OrderedDict[str, FaultEntry] = OrderedDict((fault.key, fault) for fault in known)
        self._quiet: deque[tuple[float, FaultEntry]] = deque(maxlen=MAX_QUIET)
        """Faults that ended by a heartbeat; their line may still arrive."""

    def take(self, line: Mapping[str, Any]) -> list[FaultEntry]:
        """The faults that a line has opened, changed or ended. line: made by `phm.gcs.web.events.from_line`."""
        who, utc_s = str(line["who"]), float(line["utc_s"])
        match line["event"]:
            case "text" if line["phm"] and line.get("kind") in (LineKind.CHANGE.value, LineKind.REFRESH.value):
                parsed = statustext_parser.parse(str(line["text"]))
                return [] if parsed is None else self._line(who, parsed, utc_s)
            case "detail":
                return self._detail(who, str(line["fault"]), str(line["text"]), utc_s)
            case "slots":
                healthy = [int(slot) for slot, (_, new) in dict(line["changed"]).items() if new == "OK"]
                over = self._close([one for one in self._of(who) if one.slot in healthy], utc_s, BY_HEARTBEAT)
                self._quiet.extend((utc_s, one) for one in over)
                return over
            case "restart":
                return self._close(self._of(who), utc_s, "its PHM has restarted or reloaded")
        return []

    def _line(self, who: str, line: ParsedLine, utc_s: float) -> list[FaultEntry]:
        found = self._of(who)
        if line.word == "ADVISE" and line.advice is not None:
            return self._about(
                found, line, line.advice.fault, "advised", f"{line.advice.action} {line.advice.target}", utc_s
            )
        if line.word in ("APPROVED", "EXPIRED"):
            return self._about(found, line, line.fault, line.word.lower(), line.text, utc_s)
        if line.word == "GAVE UP":
            given = self._about(found, line, line.fault, "gave up", line.text, utc_s)
            if given:
                return given
        if line.level is not None:
            return self._bad(who, line, utc_s)
        if line.kind is LineKind.REFRESH and line.word == "OK":
            return self._close(found, utc_s, "all is OK")
        if line.recovered:
            over = [one for one in found if one.slot == line.slot and line.resolves(one.text)]
            over = over or self._ended_quietly(who, line, utc_s)
            name = "recovered" if _ENDED.match(line.text) else "proof"
            for one in over:
                if name == "proof":
                    one.step("action", utc_s, f"{line.text} (reported when it was proven)")
            return self._close(over, utc_s, line.text, name)
        return []

    def _ended_quietly(self, who: str, line: ParsedLine, utc_s: float) -> list[FaultEntry]:
        """The fault that a heartbeat ended a short time ago, and whose line follows now: the line says more."""
        for at, one in reversed(self._quiet):
            if one.who == who and one.slot == line.slot and utc_s - at <= LINE_S and line.resolves(one.text):
                self._quiet.remove((at, one))
                one.steps = [step for step in one.steps if step["text"] != BY_HEARTBEAT]
                return [one]
        return []

    def _bad(self, who: str, line: ParsedLine, utc_s: float) -> list[FaultEntry]:
        level = line.level.name if line.level is not None else ""
        found = self._of(who)
        here = [one for one in found if one.slot == line.slot]
        same = [one for one in here if line.is_about(one.text)]
        if not same:
            same = [one for one in here if _VALUE.sub("", one.text) == _VALUE.sub("", line.failure)]
        others = [one for one in found if one not in same[:1]] if line.alone else []
        over = self._close(others, utc_s, BY_REFRESH)
        if same:
            value = not line.is_about(same[0].text)
            if value:
                same[0].text = line.failure
            if same[0].level == level:
                return over + (same[:1] if value else [])
            same[0].level = level
            same[0].step("confirmed", utc_s, f"{line.word} {line.text}", level=level)
            return over + same[:1]
        fault = FaultEntry(
            f"{who} {line.slot} {utc_s:.3f} {line.text}", who, line.slot, line.failure, level, utc_s, line.fault
        )
        step = "gave up" if line.word == "GAVE UP" else "confirmed"  # the line of the fault itself was not received
        fault.step(step, utc_s, f"{line.word} {line.text}", level=level)
        self._open[fault.key] = fault
        while len(self._open) > MAX_OPEN:
            self._open.popitem(last=False)
        return [*over, fault]

    def _about(
        self, found: list[FaultEntry], line: ParsedLine, number: int | None, step: str, text: str, utc_s: float
    ) -> list[FaultEntry]:
        """A step of the fault with this number, else of the newest one of the slot that the line names. If it names none, it is
        about the newest that is not known to be another."""
        here = [one for one in reversed(found) if one.slot == line.slot]
        free = [one for one in here if number is None or one.number in (None, number)]
        ranked = [one for one in free if number is not None and one.number == number]
        ranked += [one for one in free if _names(line, one)] + [one for one in here if _names(line, one)] + free
        if not ranked:
            return []
        chosen = ranked[0]
        chosen.number = number if number is not None else chosen.number
        chosen.step(step, utc_s, text)
        return [chosen]

    def _detail(self, who: str, fault: str, text: str, utc_s: float) -> list[FaultEntry]:
        since = _SINCE.search(text)
        number = fault.rpartition("-")[2]
        if since is None or not number.isdecimal():
            return []
        found = self._of(who)
        chosen = [one for one in found if one.number == int(number)] or (found if len(found) == 1 else [])
        if not chosen or any(step["step"] == "detected" for step in chosen[0].steps):
            return []
        chosen[0].number = int(number)
        at = _moment(chosen[0].at, *map(int, since.groups()))
        chosen[0].step("detected", at, text, known_utc_s=round(utc_s, 3))
        return chosen[:1]

    def _close(self, over: list[FaultEntry], utc_s: float, text: str, step: str = "recovered") -> list[FaultEntry]:
        for one in over:
            one.ended = utc_s if one.ended is None else one.ended  # a line may follow the heartbeat with the end
            one.step(step, utc_s, text)
            self._open.pop(one.key, None)
        return over

    def _of(self, who: str) -> list[FaultEntry]:
        return [one for one in self._open.values() if one.who == who]


def _names(line: ParsedLine, fault: FaultEntry) -> bool:
    """Whether a line about a fault has its text, or one about an action has a target of that text, whose middle may be cut."""
    if line.word == "GAVE UP":
        return line.is_about(fault.text)
    target = line.advice.target if line.advice is not None else line.text.partition(" ")[2]
    return target.partition("..")[0] in fault.text


def _moment(near: float, hours: int, minutes: int, seconds: int) -> float:
    """The last moment before `near` with this time of the day."""
    day = datetime.fromtimestamp(near, timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0).timestamp()
    moment = day + hours * 3600 + minutes * 60 + seconds
    return moment if moment <= near + 60 else moment - DAY_S
