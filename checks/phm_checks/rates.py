"""Slot 8: each configured topic flows at its rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._words import Steady, brief, clean, last, span

CONFIRM_S = 0.9
"""A rate must be off in two measurements, which the sampler makes once a second, before it is told."""
STAY = 0.9
"""A level is left only when the deviation is below this share of its limit, so that a rate at the limit does not flap."""
MEASURED_S = 1.0
"""A silence is seen this much after its limit at the latest: the sampler looks, and the check runs, once a second."""


@dataclass(slots=True)
class _Memory:
    """What one topic's judgement remembers between runs."""

    off_since: float | None = None
    told: api.Result | None = None


@dataclass(frozen=True, slots=True)
class _Case:
    """One topic with what was measured on it."""

    topic: api.TopicSettings
    rate: float
    target: str
    values: Mapping[str, api.Value] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return api.topic_id(self.topic.name)


class Rates(api.Check):
    """The rates of all topics that have one configured, one unit each."""

    name, slot, layer = "rates", Slot.RATES, Layer.ROS
    period_s = 1.0

    def __init__(
        self, topics: Sequence[api.TopicSettings], units: Sequence[api.Unit], ros: tuple[float, float]
    ) -> None:
        self._topics = tuple(topics)
        self._units = tuple(units)
        self._targets = {unit.id: unit.target for unit in units}
        self._grace_s, self._silence_s = ros
        self._memory = {topic.name: _Memory() for topic in topics}
        self._hz = Steady(share=0.1)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        topics = [topic for topic in settings.ros.topics if topic.rate is not None]
        units = [
            api.Unit(
                _unit(topic),
                needs=(f"topics/{api.topic_id(topic.name)}",),
                target=settings.container_of_topic(topic),
                settle_s=2.0,
                grace_s=settings.ros.grace,
                memory_s=_limit_s(topic.rate or 0.0, settings.ros.silence) + MEASURED_S,
            )
            for topic in topics
        ]
        return [cls(topics, units, (settings.ros.grace, settings.ros.silence))] if topics else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each topic; STALE for all when the ROS child says nothing."""
        try:
            fact = world.ros.look()
        except api.CannotTell as reason:
            return {_unit(topic): api.stale(str(reason)) for topic in self._topics}
        results = {}
        for topic in self._topics:
            seen = fact.topics.get(f"/{api.topic_id(topic.name)}", api.TopicFact())
            memory = self._memory[topic.name]
            memory.told = self._judge(topic, seen, fact, memory, world.clock.mono())
            results[_unit(topic)] = memory.told
        return results

    def _judge(
        self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, memory: _Memory, now: float
    ) -> api.Result:
        """Column of early returns, from what cannot be judged to what can."""
        name = api.topic_id(topic.name)
        if not topic.rate:
            return self._latched(name, seen, fact)
        if seen.rate is None:
            return api.stale(f"{name} is not measured: it has no sampler yet")
        if seen.rate.problem:
            return api.stale(
                f"rate of {name} cannot be told: {clean(seen.rate.problem)} ({len(seen.publishers)} publishers)"
            )
        hz, silent_s = seen.rate.hz, seen.rate.silent_s
        values: dict[str, api.Value] = {
            "hz": None if hz is None else round(hz, 3),
            "expected_hz": topic.rate,
            "silent_s": None if silent_s is None else round(silent_s, 2),
            "window_s": round(seen.rate.window_s, 2),
            "samples": seen.rate.samples,
        }
        case = _Case(topic, topic.rate, self._targets[_unit(topic)], values)
        if silent_s is None:
            return self._never(case, fact)
        limit_s = _limit_s(topic.rate, self._silence_s)
        if silent_s > limit_s:
            memory.off_since = None
            return self._bad(
                Level.ERROR,
                "silent",
                "silent",
                f"{name}: offline. Silent for {span(silent_s)}, expected {topic.rate:g} Hz and no gap over {span(limit_s)}: its "
                "node hangs or its source stopped; see that node's log",
                case,
            )
        if hz is None:
            return api.stale(f"{name} is received; its rate is being measured", brief="", **values)
        return self._rate(case, hz, memory, now)

    def _latched(self, name: str, seen: api.TopicFact, fact: api.RosFact) -> api.Result:
        if seen.publishers:
            return api.ok(f"{name}: latched, its publisher is there", publishers=len(seen.publishers))
        if fact.up_s < self._grace_s:
            return api.stale(f"publisher of {name} is not seen yet")
        return api.error(
            f"{name}: offline. It is latched and has no publisher: start the node that publishes it",
            brief=brief(last(name), "has no publisher"),
            condition="not_received",
            publishers=0,
        )

    def _never(self, case: _Case, fact: api.RosFact) -> api.Result:
        """Listed but not one sample; slow topics get three periods."""
        if fact.up_s < max(self._grace_s, 3 / case.rate):
            return api.stale(
                f"no sample of {case.name} yet; PHM has listened for {span(fact.up_s)} only", brief="", **case.values
            )
        return self._bad(
            Level.ERROR,
            "not_received",
            "not received",
            f"{case.name}: offline. It is listed, but not one sample has come, expected {case.rate:g} Hz: its publisher does "
            "not publish, or the transport is blocked (shared memory without a shared /dev/shm: set "
            "FASTDDS_BUILTIN_TRANSPORTS=UDPv4)",
            case,
        )

    def _rate(self, case: _Case, hz: float, memory: _Memory, now: float) -> api.Result:
        off = abs(hz - case.rate) / case.rate * 100
        tolerance = case.topic.tolerance
        before = memory.told.level if memory.told is not None else Level.OK
        warn = tolerance * (STAY if before.bad else 1.0)
        error = 2 * tolerance * (STAY if before is Level.ERROR else 1.0)
        # Rounding of a measured rate must not count: 10.000001 % is 10 %.
        if off <= warn + 1e-6:
            memory.off_since = None
            self._hz.forget(case.name)
            return api.ok(f"{case.name}: {hz:.3f}", **case.values)
        if memory.off_since is None:
            memory.off_since = now
        if now - memory.off_since < CONFIRM_S:
            if memory.told is not None and memory.told.level is not Level.STALE:
                return memory.told
            return api.stale(f"{case.name} was measured once at {hz:.3f} Hz; measuring again", brief="", **case.values)
        low = hz < case.rate
        return self._bad(
            Level.ERROR if off > error + 1e-6 else Level.WARN,
            "rate_low" if low else "rate_high",
            f"{self._hz.show(case.name, hz):.3g} Hz, not {case.rate:g}",
            f"{case.name}: {hz:.3f} Hz, {off:.0f} % too {'low' if low else 'high'}, expected {case.rate:g} Hz within "
            f"{tolerance:g} %: {'look for load or loss at its node' if low else 'look for a second publisher'}",
            case,
        )

    @staticmethod
    def _bad(level: Level, condition: str, short: str, words: str, case: _Case) -> api.Result:
        return api.Result(level, words, brief(last(case.name), short), condition, case.target, case.values)


def _limit_s(rate_hz: float, silence_s: float) -> float:
    """From when on a topic counts as silent. A latched one (rate 0) never does."""
    return max(3 / rate_hz, silence_s) if rate_hz else silence_s


def _unit(topic: api.TopicSettings) -> str:
    return f"rates/{api.topic_id(topic.name)}"
