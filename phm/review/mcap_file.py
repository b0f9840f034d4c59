"""Levels and faults of a record as an MCAP file of ROS 2 diagnostics, for Foxglove and other programs that show a recording.

`/diagnostics` has what PHM published there: at each change the unit and the summary of its agent, and all units every 4 s, so
that a program that seeks has them all, and none is shown as STALE for its age. `/phm/faults` has one status for each fault, when
it opens and when it ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phm import __version__
from phm.facts.ros import DIAGNOSTICS
from phm.review import levels
from phm.review.agent_record import AgentRecord
from phm.review.cdr import DEFINITION, TYPE, Status, diagnostic_array
from phm.review.record import Record
from phm.wire.report import NOT_APPLICABLE
from phm.wire.text import one_line

Json = dict[str, Any]
FAULTS = "/phm/faults"
WHOLE_S = 4.0
"""Foxglove and diagnostic_aggregator show a status as STALE 5 s after its last message."""
MOST_WHOLE = 20_000
"""Arrays with all units; a longer record has them less often."""
LEVELS = {"OK": 0, NOT_APPLICABLE: 0, "WARN": 1, "ERROR": 2, "STALE": 3}
STOPPED = "PHM does not run"
MAX_MESSAGE = 255


def write(record: Record, document: Json, path: str) -> int:
    """Write the window of the document; how many messages. Needs mcap. Raises OSError."""
    from mcap.writer import Writer

    begin, end = document["window"]["begin"], document["window"]["end"]
    part = Path(f"{path}.part")
    count = 0
    try:
        with part.open("wb") as stream:
            writer: Any = Writer(stream)  # some of its methods have no types
            writer.start(profile="ros2", library=f"phm {__version__}")
            schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.encode())
            channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in (DIAGNOSTICS, FAULTS)}
            for count, (t, topic, statuses) in enumerate(messages(record, document["faults"], begin, end), 1):
                stamp = max(0, round(t * 1e6)) * 1000
                writer.add_message(channels[topic], stamp, diagnostic_array(t, statuses), stamp, count)
            writer.finish()
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return count


def messages(record: Record, faults: list[Json], begin: float, end: float) -> Iterator[tuple[float, str, list[Status]]]:
    """Time, topic and statuses, in the order of time."""
    agents = [agent for agent in record.agents if agent.vehicle]
    shown = [_Shown(agent) for agent in agents]
    events: list[tuple[float, int, str, Any]] = []
    for place, agent in enumerate(agents):
        events += [(t, place, what, body) for t, what, body in _events(record, agent)]
    places = {agent.name: place for place, agent in enumerate(agents)}
    events += [event for fault in faults for event in _fault_events(fault, places[fault["agent"]])]
    events.sort(key=lambda event: event[:2])
    step = max(WHOLE_S, (end - begin) / MOST_WHOLE)
    whole = begin
    for t, place, what, body in events:
        while whole < t and whole <= end:
            yield whole, DIAGNOSTICS, [status for agent in shown for status in agent.all()]
            whole += step
        if what == "fault":
            if begin <= t <= end:
                yield t, FAULTS, [body]
            continue
        changed = shown[place].apply(what, body)
        if changed and begin <= t <= end:
            yield t, DIAGNOSTICS, changed
    yield end, DIAGNOSTICS, [status for agent in shown for status in agent.all()]


@dataclass
class _Shown:
    """What an agent's statuses say at the present moment."""

    agent: AgentRecord
    units: dict[str, Status] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)
    """The level of each unit; its status does not say whether there was nothing to evaluate."""
    level: str = "STALE"
    runs: bool = False

    def apply(self, what: str, body: Any) -> list[Status]:
        """Apply a change of the agent; return the statuses that changed."""
        if what == "level":
            self.level, self.runs = body, True
            return [self.summary()]
        if what in ("runs", "stops"):
            self.runs = what == "runs"
            return self.all()
        unit, word, status = body
        self.units[unit], self.words[unit] = status, word if word in LEVELS else "STALE"
        return [status, self.summary()] if self.runs else []

    def all(self) -> list[Status]:
        units = list(self.units.values())
        if not self.runs:
            units = [status._replace(level=LEVELS["STALE"], message=STOPPED) for status in units]
        return [self.summary(), *units]

    def summary(self) -> Status:
        name, count = self.agent.name, Counter(self.words.values())
        values = [("agent_id", str(self.agent.id))]
        values += [(word.lower(), str(count[word])) for word in ("OK", "WARN", "ERROR", "STALE")]
        not_applicable = count.pop(NOT_APPLICABLE, 0)
        values.append(("not_applicable", str(not_applicable)))
        worst = next((word for word in levels.RANK if count[word]), "OK" if self.units else self.level)
        text = f"{count['OK']} of {count.total()} units are OK" if self.units else f"{worst}, as the ground received it"
        if not self.runs:
            worst, text = "STALE", STOPPED if self.agent.runs else "nothing received yet"
        return Status(LEVELS[worst], f"phm/{name}: summary", text, name, tuple(values))


def _events(record: Record, agent: AgentRecord) -> Iterator[tuple[float, str, Any]]:
    """Levels of units over time, and when PHM ran; of an agent without a log its level as the ground received it."""
    facts: dict[str, Json] = {}
    for run, clock in agent.runs:
        for unit, body in run.units.items():
            facts.setdefault(unit, body)
            status = _status(agent, unit, body, body["level"], body["summary"])
            yield clock.t(body["at"]), "unit", (unit, body["level"], status)
    for change, clock in ((change, clock) for run, clock in agent.runs for change in run.levels()):
        more = {"condition": change.condition, "blocked_by": change.blocked_by, "fault": change.fault}
        values = {**more, **change.values}
        body = facts.get(change.unit, {})
        status = _status(agent, change.unit, body, change.level, change.summary, values)
        yield clock.t(change.mono), "unit", (change.unit, change.level, status)
    for begin, end in agent.cover:
        yield begin, "runs", None
        yield end, "stops", None
    if not agent.runs:
        for begin, _, level in levels.of_ground(record, agent.id):
            yield begin, "level", level


def _status(agent: AgentRecord, unit: str, body: Json, level: str, summary: str, values: Json | None = None) -> Status:
    """Name, message and keys as PHM publishes them: docs/reference/ros.md."""
    message = one_line(f"{NOT_APPLICABLE}: {summary}" if level == NOT_APPLICABLE else summary)[:MAX_MESSAGE]
    known = {"unit": unit, **{key: body.get(key) for key in ("check", "slot", "target")}, **(values or {})}
    name = f"phm/{agent.name}/{body.get('layer') or 'unknown'}: {unit}"
    return Status(LEVELS.get(level, LEVELS["STALE"]), name, message, agent.name, _pairs(known))


def _fault_events(fault: Json, place: int) -> Iterator[tuple[float, int, str, Status]]:
    keys = ("unit", "check", "slot", "layer", "condition", "target", "outcome", "by", "lasted_s", "acted_after_s")
    name = f"phm/{fault['agent']}/fault: {fault['fault']}"
    message = one_line(fault["summary"])[:MAX_MESSAGE]
    opened = {key: fault[key] for key in keys[:6]}
    yield fault["opened"], place, "fault", Status(LEVELS["ERROR"], name, message, fault["agent"], _pairs(opened))
    if fault["closed"] is not None:
        closed = {key: fault[key] for key in keys}
        text = one_line(f"{fault['outcome']}: {message}")[:MAX_MESSAGE]
        yield fault["closed"], place, "fault", Status(LEVELS["OK"], name, text, fault["agent"], _pairs(closed))


def _pairs(values: Json) -> tuple[tuple[str, str], ...]:
    return tuple((key, "" if value is None else one_line(str(value))[:120]) for key, value in values.items())
