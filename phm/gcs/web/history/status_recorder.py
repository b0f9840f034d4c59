"""Turns the status of one agent into entries of the history, and into events for the page. Takes each status that was read."""

from __future__ import annotations

import contextlib
import json
import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any

from phm.core.model import NO_ACTION, Level, Outcome, Stamp
from phm.gcs.samples import EACH_S, RADIO, TOPIC
from phm.gcs.web import agent_row
from phm.gcs.web.events import GRADES
from phm.gcs.web.history.collector import LEVELS, MAX_TOPICS
from phm.gcs.web.history.faults import FaultEntry
from phm.gcs.web.history.reader import HistoryError, HistoryReader
from phm.gcs.web.history.store import EVENT, FAULT, HistoryRow, HistorySample, HistoryStore
from phm.gcs.web.view import dumps
from phm.wire.report import iso

Json = dict[str, Any]
MAX_ENDED, MAX_UNITS, MAX_OPEN = 500, 2000, 500
"""What is remembered to recognise what is new: ended faults, units, and open faults."""
_WARN = Level.WARN.name
_HOST = {
    "host/cpu": ("cpu", "cpu_percent"),
    "host/memory": ("memory", "memory_percent"),
    "host/temperature": ("temperature", "temperature_c"),
}
"""Series and key of `values` of each unit of the computer."""
_RATES, _RADIO = "rates/", "radio/"


class StatusRecorder:
    """Not thread-safe."""

    def __init__(self, store: HistoryStore, reader: HistoryReader) -> None:
        """reader: knows the faults and the flight of the page's last run."""
        self._store, self._reader = store, reader
        self._open = {fault.key: fault for fault in reader.open_faults()}
        self._ended: OrderedDict[str, None] = OrderedDict()
        with contextlib.suppress(HistoryError):
            self._ended.update((str(body.get("key")), None) for body in reader.faults("")["faults"] if not body["open"])
        self._who = self._boot = ""
        self._started: object = None
        self._healthy: bool | None = None
        self._armed: bool | None = None
        self._units: dict[str, str] = {}
        self._holds: dict[str, str] | None = None
        self._level: int | None = None
        self._sampled = float("-inf")
        self._seq = 0

    def take(self, document: Mapping[str, Any], row: Mapping[str, Any], at: Stamp) -> list[Json]:
        """The events that follow from a status. document: as `phm.wire.status_shape.read` returns it, or empty. row: the row of the page
        that was made from it. at: when it was read."""
        if document and row["name"] != self._who:
            self._begin(str(row["name"]))
        if not self._who:
            return []
        healthy = row["presence"] == "alive"
        found = list(self._presence(document, row, healthy, at))
        if healthy:
            found += [*self._autopilot(document, at), *self._held(document, at), *self._warnings(row, at)]
            found += self._faults(document, at)
            self._samples(document, row, at)
        for event in found:
            values = (event["utc_s"], self._who, GRADES.index(event["grade"]), event["event"], event["words"])
            self._store.put(HistoryRow(EVENT, (*values, dumps(event))))
        return found

    def _begin(self, who: str) -> None:
        """Another agent, or the first one: what is known of it is in the history."""
        self._who, self._healthy, self._units, self._holds, self._level = who, None, {}, None, None
        self._armed = None
        with contextlib.suppress(HistoryError):
            last = self._reader.events(
                who=who, event="autopilot", text="", grade="", before=None, until=math.inf, limit=1
            )
            self._armed = next((bool(body.get("armed")) for body in last["events"]), None)

    def _event(self, event: str, grade: str, words: str, at: Stamp, utc_s: float | None = None, **more: object) -> Json:
        """utc_s: when it happened, if that is not when it was read."""
        self._seq += 1
        when = at.utc if utc_s is None else utc_s
        head = {"seq": self._seq, "utc": iso(when), "utc_s": round(when, 3), "mono": round(at.mono, 3), "event": event}
        return {**head, "name": self._who, **more, "words": agent_row.text(words), "who": self._who, "grade": grade}

    # ------------------------------------------------------------ events

    def _presence(
        self, document: Mapping[str, Any], row: Mapping[str, Any], healthy: bool, at: Stamp
    ) -> Iterator[Json]:
        before, self._healthy = self._healthy, healthy
        boot = str(document.get("boot_id", "")) if healthy else self._boot
        started = document.get("health", {}).get("started_utc") if healthy else self._started
        another, same_start = bool(self._boot) and boot != self._boot, started is not None and started == self._started
        self._boot, self._started = boot, started
        if another and same_start:
            yield self._event("reload", "info", f"{self._who} PHM has reloaded its configuration", at)
        elif another:
            yield self._event("restart", "warn", f"{self._who} PHM has restarted", at)
        elif before is False and healthy:
            yield self._event("presence", "ok", f"{self._who} PHM works again", at, presence="alive")
        if before and not healthy:
            self._level = None
            self._store.put(HistorySample(self._who, "level", at.utc, 0.0))
            yield self._event("presence", "error", f"{self._who} is lost: {row['problem']}", at, presence="lost")

    def _autopilot(self, document: Mapping[str, Any], at: Stamp) -> Iterator[Json]:
        armed = document.get("armed")
        if armed is not None and armed is not self._armed:
            self._armed = armed
            yield self._event("autopilot", "info", f"autopilot is {'armed' if armed else 'disarmed'}", at, armed=armed)

    def _held(self, document: Mapping[str, Any], at: Stamp) -> Iterator[Json]:
        held = {
            f"{hold['container'] or 'all containers'} by {hold['by']}": str(hold["reason"])
            for hold in document.get("holds", ())
        }
        before, self._holds = self._holds, held
        if before is None:
            return
        for name in held.keys() - before.keys():
            yield self._event("hold", "info", f"on hold: {name}{': ' if held[name] else ''}{held[name]}", at)
        for name in before.keys() - held.keys():
            yield self._event("hold", "info", f"no longer on hold: {name}", at)

    def _warnings(self, row: Mapping[str, Any], at: Stamp) -> Iterator[Json]:
        """Units that become WARN, and those that no longer are; of an ERROR, its fault says more."""
        units = list(row["checks"])[:MAX_UNITS]
        before, self._units = self._units, {one["unit"]: one["level"] for one in units}
        for one in units:
            was, level = before.get(one["unit"]), one["level"]
            if level == _WARN and was != _WARN and before:
                yield self._event("unit", "warn", f"{one['unit']} WARN: {one['text']}", at, unit=one["unit"])
            elif was == _WARN and level not in (_WARN, Level.ERROR.name):
                grade = "ok" if level == Level.OK.name else "info"
                yield self._event("unit", grade, f"{one['unit']} {level}: {one['text']}", at, unit=one["unit"])

    # ------------------------------------------------------------ faults

    def _faults(self, document: Mapping[str, Any], at: Stamp) -> Iterator[Json]:
        faults = document.get("faults", {})
        given_up = {self._key(body): body for body in faults.get("given_up", ())}
        bad = {**given_up, **{self._key(body): body for body in faults.get("open", ())}}
        for key, body in list(bad.items())[:MAX_OPEN]:
            yield from self._opened(key, body, at)
            if key in given_up and not any(step["step"] == "gave up" for step in self._open[key].steps):
                self._open[key].step("gave up", at.utc, "recovery has given up on it")
                self._keep(self._open[key], at.utc)
                yield self._event("fault", "error", f"fault {body['fault']}: recovery has given up on it", at)
        over = {self._key(body): body for body in faults.get("closed", ())}
        for key, body in over.items():
            if key not in bad and key not in self._ended:
                yield from self._opened(key, body, at)
                yield from self._closed(self._open[key], body, at)
        for key, entry in list(self._open.items()):
            if entry.who == self._who and key not in bad:
                yield from self._closed(entry, None, at)

    def _key(self, body: Mapping[str, Any]) -> str:
        # Ids begin with four digits of the run alone, so that they repeat in a history of years.
        return agent_row.text(f"{self._who} {body['fault']} {body['opened']}")

    def _opened(self, key: str, body: Mapping[str, Any], at: Stamp) -> Iterator[Json]:
        if key in self._open:
            return
        self._ended.pop(key, None)
        opened = agent_row.utc_seconds(body["opened"])
        utc_s = at.utc if opened is None else opened
        slot, number = body.get("slot"), str(body["fault"]).rpartition("-")[2]
        text = agent_row.text(f"{body['unit']} {body['summary']}")
        entry = FaultEntry(
            key,
            self._who,
            slot if isinstance(slot, int) else 0,
            text,
            Level.ERROR.name,
            utc_s,
            int(number) if number.isdecimal() and len(number) < 10 else None,
        )
        entry.step("confirmed", utc_s, text, level=Level.ERROR.name)
        self._open[key] = entry
        self._keep(entry, utc_s)
        yield self._event("fault", "error", f"fault {body['fault']}: {text}", at, utc_s, fault=body["fault"])

    def _closed(self, entry: FaultEntry, body: Mapping[str, Any] | None, at: Stamp) -> Iterator[Json]:
        """End a fault. body: None if the status does not say how it ended."""
        del self._open[entry.key]
        self._ended[entry.key] = None
        while len(self._ended) > MAX_ENDED:
            self._ended.popitem(last=False)
        outcome, by = ("", "") if body is None else (str(body["outcome"]), agent_row.text(body["by"]))
        closed = None if body is None or outcome == Outcome.ESCALATED else agent_row.utc_seconds(body.get("closed"))
        entry.ended = at.utc if closed is None else max(closed, entry.at)
        acted = outcome == Outcome.RESOLVED and by not in NO_ACTION
        words = f"resolved by {by}" if outcome == Outcome.RESOLVED and by else outcome or "no longer reported"
        if outcome == Outcome.ESCALATED:
            words = "no longer bad"
        if acted:
            entry.step("action", entry.ended, f"{by} (known when it was proven)")
        entry.step("proof" if acted else "recovered", entry.ended, words)
        self._keep(entry, entry.ended)
        yield self._event("fault", "ok", f"fault ended: {words}: {entry.text}", at, entry.ended)

    def _keep(self, entry: FaultEntry, changed: float) -> None:
        values = (entry.key, entry.who, entry.at, changed, int(entry.open), json.dumps(entry.json()))
        self._store.put(HistoryRow(FAULT, values))

    # ------------------------------------------------------------ samples

    def _samples(self, document: Mapping[str, Any], row: Mapping[str, Any], at: Stamp) -> None:
        level = max((LEVELS.get(Level[name], 0) for name in row["slots"].values()), default=0)
        due = at.mono - self._sampled >= EACH_S
        if due or level != self._level:
            self._level = level
            self._store.put(HistorySample(self._who, "level", at.utc, float(level)))
        if due:
            self._sampled = at.mono
            for kind, value in _values(document):
                self._store.put(HistorySample(self._who, kind, at.utc, value))


def _values(document: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Series and value of what the checks have measured."""
    topics, radio = 0, ""
    for one in document.get("checks", ()):
        unit, values = agent_row.text(one["id"]), one.get("values")
        if not isinstance(values, dict):
            continue
        wanted = [_HOST[unit]] if unit in _HOST else []
        if unit.startswith(_RATES) and topics < MAX_TOPICS:
            topics += 1
            wanted = [(f"{TOPIC}{unit.removeprefix(_RATES)}", "hz")]
        elif unit.startswith(_RADIO) and radio in ("", unit):  # the first one: series have the names of a single radio
            wanted = [
                (kind, "txbuf_percent" if kind == "txbuf" else kind) for kind in RADIO if values.get("rssi") is not None
            ]
            radio = unit if wanted else radio
        for kind, key in wanted:
            value = agent_row.finite(values.get(key))
            if value is not None:
                yield kind, value
