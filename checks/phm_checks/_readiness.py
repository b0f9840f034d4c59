"""Rules of readiness, which the checks `node_ready` and `container_ready` share.

What is not ready is alive: a dead node or container is reported by `nodes` or `container`, on which these units depend.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from phm import api
from phm.api import Level
from phm_checks._ros_facts import full_name, is_large
from phm_checks._text import brief, clean, last, listed, span

SETTLE_S = 3.0
"""A node that starts again within its running container is not ready for a moment, and its death may be known later."""
UNANSWERED_S = 5.0
"""A lifecycle node that has not answered for this long is not ready."""
NOT_LISTED = "a name in the ROS domain is not UTF-8"
BUSY = "PHM restarts nothing for this: it may be busy"
LARGE_PAUSE_S = 2.5
"""Large topics are received only every two seconds (`phm.probes.ros.rates.topic_monitor`)."""


@dataclass(frozen=True, slots=True)
class Unmet:
    """A requirement that is not met, or of which PHM cannot tell (`unknown`).

    short: for the operator's line. observed: it was observed directly, not inferred from silence or absence.
    unanswered: only an answer is missing, which a busy node gives late. silent: only messages are, which it sends late.
    """

    words: str
    short: str = ""
    unknown: bool = False
    observed: bool = False
    unanswered: bool = False
    silent: bool = False


@dataclass(frozen=True, slots=True)
class Subject:
    """A node or container whose readiness is checked. name: as in a sentence, e.g. `node /a/b`."""

    unit: str
    name: str
    ready: api.ReadySettings
    container: str

    def as_unit(self, needs: Iterable[str], settings: api.Settings) -> api.Unit:
        """Its unit, with the start-up time as grace."""
        parts = ("container", "network")
        home = [f"{part}/{self.container}" for part in parts] if self.container else []
        grace_s = max(self.ready.within, settings.ros.grace)
        return api.Unit(self.unit, (*home, *needs), self.container, SETTLE_S, grace_s)

    def result(self, found: Sequence[Unmet], remedy: str, **values: api.Value) -> api.Result:
        """The result when its requirements have these findings: ready without any."""
        missing = [one for one in found if not one.unknown]
        if found and not missing:
            reasons = "; ".join(one.words for one in found)
            return api.Result(Level.STALE, f"not known whether {self.name} is ready: {reasons}", values=values)
        if not missing:
            names = [*self.ready.services, *self.ready.topics, *filter(None, [self.ready.call])]
            what = f": {listed(names)}" if names else ""
            return api.ok(f"{self.name[0].upper()}{self.name[1:]} is ready{what}", values=values)
        level = Level.ERROR if self.ready.level == "error" else Level.WARN
        words = "; ".join(one.words for one in missing)
        busy = any(one.unanswered for one in missing) and all(one.unanswered or one.silent for one in missing)
        nothing = f". {BUSY}" if busy and level is Level.ERROR else ""
        return api.Result(
            level,
            f"{self.name} runs and is not ready: {words}. {remedy}{nothing}",
            brief(last(self.unit), f"not ready: {missing[0].short}"[:30]),
            "not_ready",
            self.container if level is Level.ERROR and not busy else "",
            values,
            evidence=api.Evidence(conclusive=any(one.observed for one in missing)),
        )


class Requirements:
    """Compares one snapshot with what is required."""

    def __init__(self, fact: api.RosFact, settings: api.RosSettings) -> None:
        self._fact = fact
        self._silence_s = settings.silence
        self._young = fact.up_s < settings.grace
        """Whether PHM has looked for too short a time to know that something is absent."""

    def unmet(self, ready: api.ReadySettings) -> list[Unmet]:
        """Findings about services and topics, in the order of the configuration."""
        limit_s = self._silence_s if ready.silence is None else ready.silence
        found = [self._service(full_name(name)) for name in ready.services]
        found += [self._topic(full_name(name), limit_s) for name in ready.topics]
        if ready.call is not None:
            found.append(self._call(full_name(ready.call)))
        return [one for one in found if one is not None]

    def lifecycle(self, node: str, expected: str) -> Unmet | None:
        """The finding about a node's lifecycle state; None: it is as expected."""
        seen, service = self._fact.lifecycle.get(node, api.AnswerFact()), f"{node}/get_state"
        if not seen.served and not seen.problem:
            words = f"it has no service {service}, expected of a lifecycle node"
            return Unmet(words, "no lifecycle", unknown=self._young)
        if (silent := self._unanswered(service, seen)) is not None:
            return silent
        state = clean(seen.answer, 20)
        if state == expected:
            return None
        return Unmet(f"its lifecycle state is {state}, expected {expected}", state, observed=True)

    def _call(self, service: str) -> Unmet | None:
        seen = self._fact.calls.get(service, api.AnswerFact())
        if not seen.served and not seen.problem:
            return Unmet(f"service {service} has no server", f"no {last(service)}", unknown=self._young)
        if (silent := self._unanswered(service, seen)) is not None or seen.answer == "true":
            return silent
        return Unmet(f"service {service} answers: {clean(seen.detail) or 'not ready'}", last(service), observed=True)

    def _unanswered(self, service: str, seen: api.AnswerFact) -> Unmet | None:
        if seen.problem:
            return Unmet(f"{service} cannot be called: {clean(seen.problem)}", unknown=True)
        if seen.unanswered_s >= UNANSWERED_S:
            return Unmet(f"{service} has not answered for {span(seen.unanswered_s)}", "no answer", unanswered=True)
        return None if seen.answer else Unmet(f"{service} has not answered yet", unknown=True)

    def _service(self, name: str) -> Unmet | None:
        count = self._fact.services.get(name, 0)
        if count is None:
            return Unmet(f"the servers of {name} are unknown: {NOT_LISTED}", unknown=True)
        if count:
            return None
        return Unmet(f"service {name} has no server", f"no {last(name)}", unknown=self._young)

    def _topic(self, name: str, limit_s: float) -> Unmet | None:
        seen = self._fact.topics.get(name, api.TopicFact())
        rate = seen.rate
        if rate is not None and rate.problem and not rate.problem.startswith("ambiguous"):
            return Unmet(f"topic {name} cannot be received: {clean(rate.problem)}", unknown=True)
        if rate is None or rate.silent_s is None:
            what = "was never received" if seen.publishers else "has no publisher"
            young = self._young or self._fact.listened_for_s < limit_s
            return Unmet(f"topic {name} {what}", f"no {last(name)}", unknown=young)
        if any((end.durability, end.reliability) == ("transient_local", "reliable") for end in seen.publishers):
            return None  # latched: one message is enough, whatever else publishes beside the one that keeps it
        silent_s = rate.silent_s - rate.not_counted_s
        if silent_s <= limit_s + (LARGE_PAUSE_S if is_large(rate, rate.hz or 0.0) else 0.0):
            return None
        words = f"topic {name} is silent for {span(silent_s)}, expected a message at least every {span(limit_s)}"
        return Unmet(words, f"{last(name)} silent", silent=True)
