"""Type `topic`: messages of a ROS topic arrive, and a field of them is within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phm import api
from phm_checks._custom.base import Finding, bad, good
from phm_checks._custom.limits import Reading, judge
from phm_checks._custom.ros import RosCheck
from phm_checks._readiness import LARGE_PAUSE_S
from phm_checks._ros_facts import full_name, is_large, snapshot
from phm_checks._text import clean, span

REMEDY = "install the package of its type where rclpy comes from, or name the application's workspace in ros.installs"


class Topic(RosCheck):
    """The values come from the few messages that the ROS child process examines. A topic without its publisher is one fault."""

    @property
    def units(self) -> Sequence[api.Unit]:
        (unit,) = super().units
        return (replace(unit, needs=(*unit.needs, f"topics/{api.topic_id(self.entry.topic)}")),)

    def observe(self, world: api.World) -> Finding:
        entry, fact = self.entry, snapshot(world)
        name = full_name(entry.topic)
        seen = fact.topics.get(name, api.TopicFact())
        types = sorted({end.type for end in seen.publishers if end.type})
        if entry.message is not None and types and types != [entry.message]:
            published = " and as ".join(clean(kind, 100) for kind in types[:3])
            return bad(f"{name} is published as {published}, expected {entry.message}", "wrong type")
        rate = seen.rate
        if rate is not None and rate.problem and not rate.problem.startswith("ambiguous"):
            raise api.CannotTell(f"{name} cannot be received: {clean(rate.problem)}")
        if rate is None or rate.silent_s is None:
            return self._never(name, seen, fact)
        silent_s = max(0.0, rate.silent_s - rate.not_counted_s)
        pause_s = LARGE_PAUSE_S if is_large(rate, rate.hz or 0.0) else 0.0
        if entry.max_age is not None and silent_s > entry.max_age + pause_s:
            words = f"{name} has had no message for {span(silent_s)}, expected one every {span(entry.max_age)}"
            return bad(words, "silent", age_s=round(silent_s, 1))
        if entry.field is None:
            return good(f"{name} was received {span(silent_s)} ago", age_s=round(silent_s, 1))
        found = self._field(name, seen)
        reading = Reading(found.low, found.high, found.nan, found.text)
        return judge(entry, f"{entry.field} of {name}", reading, age_s=round(silent_s, 1))

    def _never(self, name: str, seen: api.TopicFact, fact: api.RosFact) -> Finding:
        if fact.up_s < self.settings.ros.grace or fact.listened_for_s < (self.entry.max_age or 0.0):
            raise api.CannotTell(f"no message of {name} received yet")
        if not seen.publishers:
            return bad(f"{name} has no publisher", "no publisher")
        return bad(f"{name} has a publisher, but no message was received", "no message")

    def _field(self, name: str, seen: api.TopicFact) -> api.FieldFact:
        data = seen.data
        if data is None:
            raise api.CannotTell(f"no message of {name} was examined yet")
        found = next((one for one in data.fields if one.field == self.entry.field), None)
        problem = clean(found.problem if found is not None else data.problem, 200)
        if found is None or problem:
            remedy = f"; {REMEDY}" if "type unknown" in problem else ""
            raise api.CannotTell(f"{self.entry.field} of {name} is not known: {problem or 'not examined yet'}{remedy}")
        return found
