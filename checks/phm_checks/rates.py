"""Slot 8: each configured topic is published at its expected rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._environment_advice import advice
from phm_checks._limit_forecast import LimitForecast
from phm_checks._node_activity import FRESH_S, ran_s, turned_s
from phm_checks._ros_facts import full_name, is_large
from phm_checks._text import StableNumber, brief, clean, last, span
from phm_checks._unreceived_topics import UnreceivedTopics, publishers_of
from phm_checks._witnesses import Arrivals

CONFIRM_S = 0.9
"""A rate must be wrong in two measurements, made once a second, before it is reported."""
SETTLE_S = 2.0
"""A topic may fall silent so much earlier than its node is known to be dead. `phm.probes.ros.rates.silence` relies on it."""
GAP_PERIODS = 5
"""A topic whose node is known to be alive is not reported as silent before this many periods, or SETTLE_S after its limit if
that is sooner."""
STAY = 0.9
"""Hysteresis: a level ends only when the deviation is below this share of its limit."""
MEASURED_S = 1.0
"""A silence is detected at most this much after its limit: the sampler and the check run once a second."""
_BLOCKS = "a firewall, or shared memory without a shared /dev/shm: set FASTDDS_BUILTIN_TRANSPORTS=UDPv4"
PACKET_BYTES = 65_000
"""A larger message is lost with any of its packets: PHM's subscription is best effort."""
_LARGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2")
"""Types of messages that are so large, as far as none was received."""
_LOST = ", or its messages are lost on the way to PHM: raise net.core.rmem_default on its host"
RAN_S = 2.0
"""A publisher whose executor ran twice, this long after a message was due, and did not send it, is not just waiting for a CPU: the
timer of the message was due before the first turn, so it was called before the second."""
LATE_S = 0.1
"""An executor with a larger delay is waiting for the CPU."""
DOUBTS = 2.5
"""This many standard deviations of a rate are added to its tolerance: normal jitter of a publisher is not a fault."""
JITTER_SHARE = 0.5
"""Of the period: samples with more jitter are as likely in the wrong period as in their own."""


@dataclass(slots=True)
class _Memory:
    """State of one topic between runs."""

    off_since: float | None = None
    reported: api.Result | None = None
    widening: LimitForecast | None = None
    listed: tuple[api.EndpointFact, ...] = ()
    """Its publishers, as discovery lists them without a change since `listed_from` (monotonic seconds)."""
    listed_from: float = 0.0


@dataclass(frozen=True, slots=True)
class _Case:
    """One topic with its measurements."""

    topic: api.TopicSettings
    rate: float
    target: str
    values: Mapping[str, api.Value]

    @property
    def name(self) -> str:
        return api.topic_id(self.topic.name)


class Rates(api.Check):
    """The rates of all topics that have one configured, one unit each."""

    name, slot, layer = "rates", Slot.RATES, Layer.ROS
    period_s = 1.0

    def __init__(
        self,
        topics: Sequence[api.TopicSettings],
        units: Sequence[api.Unit],
        grace_s: float,
        trends: api.TrendSettings,
        arrivals: Mapping[str, Arrivals],
    ) -> None:
        """arrivals: by container."""
        self._topics = tuple(topics)
        self._units = tuple(units)
        self._targets = {unit.id: unit.target for unit in units}
        targets = {topic.name: self._targets[_unit(topic)] for topic in topics}
        self._unreceived = UnreceivedTopics(topics, targets, grace_s, arrivals)
        self._grace_s = grace_s
        self._memory = {
            topic.name: _Memory(widening=LimitForecast(trends.jitter, trends.confidence)) for topic in topics
        }
        self._hz = StableNumber(share=0.1)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        topics = [topic for topic in settings.ros.topics if topic.rate is not None]
        units = [
            api.Unit(
                _unit(topic),
                needs=(f"topics/{api.topic_id(topic.name)}",),
                target=settings.container_of_topic(topic),
                settle_s=SETTLE_S,
                grace_s=settings.ros.grace,
                memory_s=_limit_s(topic, settings.ros.silence) + MEASURED_S,
                node=next(map(full_name, topic.publishers), ""),
            )
            for topic in topics
        ]
        arrivals = {unit.target: Arrivals(unit.target, settings) for unit in units}
        return [cls(topics, units, settings.ros.grace, settings.trends, arrivals)] if topics else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each topic; STALE for all without data from the ROS child process."""
        try:
            fact = world.ros.snapshot()
        except api.CannotTell as reason:
            return {_unit(topic): api.stale(str(reason)) for topic in self._topics}
        self._unreceived.observe(world, fact)
        results = {}
        for topic in self._topics:
            seen = fact.topics.get(full_name(topic.name), api.TopicFact())
            memory = self._memory[topic.name]
            if seen.publishers != memory.listed:
                memory.listed, memory.listed_from = seen.publishers, world.clock.mono()
            measured = None if seen.rate is None or seen.rate.problem else seen.rate.hz
            memory.reported = replace(self._judge(topic, seen, fact, memory, world), rate_hz=measured)
            results[_unit(topic)] = memory.reported
        return results

    def _judge(
        self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact, memory: _Memory, world: api.World
    ) -> api.Result:
        """Early returns, from unmeasurable topics to measured ones."""
        name = api.topic_id(topic.name)
        if not topic.rate:
            return self._latched(name, seen, fact)
        if seen.rate is None:
            return api.stale(f"{name} is not measured yet: it has no sampler")
        values = _values(topic, seen.rate)
        if seen.rate.problem:
            return api.stale(f"rate of {name} cannot be measured: {clean(seen.rate.problem)}", values=values)
        case = _Case(topic, topic.rate, self._targets[_unit(topic)], values)
        hz, silent_s = seen.rate.hz, seen.rate.silent_s
        if silent_s is None:
            return self._never(case, seen, fact, world)
        if hz == 0.0:
            memory.off_since = None
            return self._silent(case, silent_s, seen, fact, memory, world.clock.mono())
        if hz is None:
            return api.stale(f"{name} is received; measuring its rate", values=values)
        return self._rate(case, hz, seen, fact, memory, world.clock.mono())

    def _silent(
        self, case: _Case, silent_s: float, seen: api.TopicFact, fact: api.RosFact, memory: _Memory, now: float
    ) -> api.Result:
        assert seen.rate is not None
        reports = [fact.received_only_elsewhere(node) for node in publishers_of(seen)]
        if reports and all(reports):
            return api.stale(
                f"{case.name} is silent here, and so is its node, which other nodes receive: PHM's own participant may have lost it",
                values=case.values,
            )
        limit_s = seen.rate.limit_s
        limit = "" if limit_s is None else f" and no gap over {span(limit_s)}"
        # The time at which a topic that is sampled with pauses fell silent is not known.
        known = not is_large(seen.rate, case.rate)
        due_s = max(silent_s, seen.rate.age_s or 0.0) - 1 / case.rate
        turns = known and _all_turned(seen, fact, due_s)
        why = (
            "its data source stopped, the node itself is running"
            if turns
            else "its node is hung or its data source stopped"
        )
        result = self._bad(
            Level.ERROR,
            "topic_silent",
            "silent",
            f"{case.name}: offline. Silent for {span(silent_s)}, expected {case.rate:g} Hz{limit}: {why}{_lost(seen)}; check that node's log",
            case,
        )
        ran = turns and all(ran_s(node, fact, now) <= due_s - RAN_S for node in publishers_of(seen))
        # A publisher that has just been discovered again may have sent what PHM's reader was not connected for.
        connected = min(now - memory.listed_from, fact.up_s) >= due_s
        result = result.with_evidence(api.Evidence(conclusive=ran and connected and _inputs_flow(seen, fact)))
        settle_s = GAP_PERIODS / case.rate - (limit_s or 0.0)
        return replace(result, settle_s=min(SETTLE_S, max(0.0, settle_s))) if turns else result

    def _latched(self, name: str, seen: api.TopicFact, fact: api.RosFact) -> api.Result:
        """A latched topic: it must have a publisher, and PHM must receive the sample that the publisher keeps."""
        if not seen.publishers:
            if fact.up_s < self._grace_s:
                return api.stale(f"publisher of {name} not discovered yet")
            return api.error(
                f"{name}: offline. It is latched but has no publisher: start the node that publishes it",
                brief=brief(last(name), "has no publisher"),
                condition="not_received",
                values={"publishers": 0},
            )
        values: dict[str, api.Value] = {"publishers": len(seen.publishers)}
        rate = seen.rate
        if rate is None or rate.problem:
            return api.ok(f"{name}: latched, its publisher exists", values=values)
        if rate.age_s is not None:
            return api.ok(
                f"{name}: latched, published {span(rate.age_s)} ago", values={"age_s": round(rate.age_s, 1), **values}
            )
        kept = all((end.durability, end.reliability) == ("transient_local", "reliable") for end in seen.publishers)
        if rate.silent_s is None and kept and fact.up_s >= self._grace_s:
            return api.warn(
                f"{name}: not received. Its publisher keeps its last sample for late subscribers, but none was received: nothing "
                "was published yet, or the transport is blocked",
                brief=brief(last(name), "not received"),
                condition="not_received",
                values={"publishers": len(seen.publishers)},
            )
        return api.ok(f"{name}: latched, its publisher exists", values=values)

    def _never(self, case: _Case, seen: api.TopicFact, fact: api.RosFact, world: api.World) -> api.Result:
        """A topic that is listed but was never received. Slow topics get three periods."""
        if not self._unreceived.due(case.topic, fact):
            return api.stale(
                f"no sample of {case.name} yet; PHM has listened for only {span(fact.listened_for_s)}",
                values=case.values,
            )
        if evidence := self._unreceived.blocked(case.target, seen, fact):
            return self._bad(
                Level.ERROR,
                "transport_blocked",
                "transport blocked",
                f"{case.name}: transport blocked. {evidence}: discovery works but no data arrives "
                f"({advice(world, case.target, _BLOCKS, data_only=True)}); a restart of the application does not help",
                case,
            ).with_evidence(api.Evidence(patient=True))
        if self._unreceived.fell_silent(case.topic, seen, fact):
            return self._bad(
                Level.ERROR,
                "topic_silent",
                "silent",
                f"{case.name}: offline. It was received earlier in this run of its container, and not since PHM's ROS process was started "
                f"{span(fact.up_s)} ago, expected {case.rate:g} Hz, while its node is received: its data source stopped; check that node's log",
                case,
            )
        return self._bad(
            Level.ERROR,
            "not_received",
            "not received",
            f"{case.name}: offline. It is listed, but no sample was received, expected {case.rate:g} Hz: its publisher does "
            f"not publish, or the transport is blocked ({_BLOCKS}){_lost(seen)}",
            case,
        )

    def _rate(
        self, case: _Case, hz: float, seen: api.TopicFact, fact: api.RosFact, memory: _Memory, now: float
    ) -> api.Result:
        measured = seen.rate
        assert measured is not None
        off = abs(hz - case.rate) / case.rate * 100
        doubt = DOUBTS * 100 * (measured.error_hz or 0.0) / case.rate
        before = memory.reported.level if memory.reported is not None else Level.OK
        warn = (case.topic.tolerance + doubt) * (STAY if before.bad else 1.0)
        error = (case.topic.error_limit + doubt) * (STAY if before is Level.ERROR else 1.0)
        # Rounding of a measured rate must not count: 10.000001 % is 10 %.
        if off <= warn + 1e-6:
            memory.off_since = None
            self._hz.forget(case.name)
            return self._widening(case, measured, memory, now) or api.ok(f"{case.name}: {hz:.3f}", values=case.values)
        if memory.off_since is None:
            memory.off_since = now
        sure = self._changed(seen, fact)
        if not sure and not _confirmed(case, measured, now - memory.off_since):
            if memory.reported is not None and memory.reported.level is not Level.STALE:
                return memory.reported
            return api.stale(f"{case.name} was measured once at {hz:.3f} Hz; measuring again", values=case.values)
        low = hz < case.rate
        result = self._bad(
            Level.ERROR if off > error + 1e-6 else Level.WARN,
            "rate_low" if low else "rate_high",
            f"{self._hz.show(case.name, hz):.3g} Hz, not {case.rate:g}",
            f"{case.name}: {hz:.3f} Hz, {off:.0f} % too {'low' if low else 'high'}, expected {case.rate:g} Hz within "
            f"{case.topic.tolerance:g} %{_why_doubt(doubt)}: "
            f"{'check its node for load or loss' if low else 'look for a second publisher'}",
            case,
        )
        return replace(result, settle_s=0.0) if sure else result

    def _widening(self, case: _Case, measured: api.RateFact, memory: _Memory, now: float) -> api.Result | None:
        """Samples that come ever more irregularly, at the right rate: something on their way runs out of room."""
        limit_s, forecast = JITTER_SHARE / case.rate, memory.widening
        jitter_s = measured.jitter_s
        soon = None if forecast is None else forecast.soon(now, jitter_s, limit_s)
        if soon is None or forecast is None or jitter_s is None or jitter_s >= limit_s:
            return None
        found = self._bad(
            Level.WARN,
            "jitter_rising",
            f"jitter too high {forecast.short(soon)}",
            f"{case.name}: its jitter of {1000 * jitter_s:.0f} ms rises to half of its period, {1000 * limit_s:.0f} ms, "
            f"{forecast.words(soon)}: look for a queue, a log or a disk that fills, and for growing load",
            case,
        )
        return found.with_evidence(api.Evidence(forecast=True))

    def _changed(self, seen: api.TopicFact, fact: api.RosFact) -> bool:
        """Whether the rate has certainly changed: each measurement shows it, and the machine is not slow in general."""
        if seen.rate is None or seen.rate.changed_s is None:
            return False
        nodes = publishers_of(seen)
        topics = (fact.topics.get(full_name(topic.name), api.TopicFact()) for topic in self._topics)
        others = (topic.rate for topic in topics if topic.rate is not None and nodes.isdisjoint(publishers_of(topic)))
        if any(other.changed_s is not None or other.hz == 0.0 for other in others):
            return False
        beacons = (fact.beacons[node] for node in nodes if node in fact.beacons)
        return all(beacon.late_s <= LATE_S and beacon.age_s <= FRESH_S for beacon in beacons)

    @staticmethod
    def _bad(level: Level, condition: str, short: str, words: str, case: _Case) -> api.Result:
        return api.Result(level, words, brief(last(case.name), short), condition, case.target, case.values)


def _values(topic: api.TopicSettings, rate: api.RateFact) -> dict[str, api.Value]:
    return {
        "hz": _rounded(rate.hz, 3),
        "expected_hz": topic.rate,
        "error_hz": _rounded(rate.error_hz, 4),
        "changed_s": _rounded(rate.changed_s, 2),
        "silent_s": _rounded(rate.silent_s, 2),
        "silent_limit_s": _rounded(rate.limit_s, 2),
        "jitter_s": _rounded(rate.jitter_s, 4),
        "age_s": _rounded(rate.age_s, 3),
        "window_s": round(rate.window_s, 2),
        "samples": rate.samples,
        "sample_bytes": _rounded(rate.sample_bytes, 0),
        "publishers": rate.publishers,
        "restarts": rate.restarts,
    }


def _confirmed(case: _Case, measured: api.RateFact, off_s: float) -> bool:
    """Whether a rate has been wrong long enough. If one sample changes the rate by more than the tolerance, the deviation
    must last longer than the window and the publisher's jitter must be known."""
    if 100 / (case.rate * max(measured.window_s, 1.0)) <= case.topic.tolerance:
        return off_s >= CONFIRM_S
    return measured.error_hz is not None and off_s >= max(CONFIRM_S, measured.window_s)


def _why_doubt(doubt: float) -> str:
    return f", and {doubt:.0f} % for its jitter" if doubt >= 1 else ""


def _rounded(number: float | None, digits: int) -> float | None:
    return None if number is None else round(number, digits)


def _all_turned(seen: api.TopicFact, fact: api.RosFact, due_s: float) -> bool:
    """Whether the executors of all its publishers ran since a message was due, `due_s` ago, so that none is hung or dead.

    Each publisher's node must be listed exactly once.
    """
    nodes = publishers_of(seen)
    return bool(nodes) and all(fact.nodes.get(node) == 1 and turned_s(node, fact) <= due_s for node in nodes)


def _inputs_flow(seen: api.TopicFact, fact: api.RosFact) -> bool:
    """Whether data arrives on all configured topics to which the publishers subscribe: a node may publish once per input."""
    publishers = publishers_of(seen)
    inputs = (topic for topic in fact.topics.values() if topic is not seen)
    needed = (topic for topic in inputs if any(end.node in publishers for end in topic.subscribers))
    return all(topic.rate is not None and bool(topic.rate.hz) for topic in needed)


def _lost(seen: api.TopicFact) -> str:
    """A clause for messages that may be too large to arrive."""
    size = None if seen.rate is None else seen.rate.sample_bytes
    large = any(end.type in _LARGE_TYPES for end in seen.publishers) if size is None else size > PACKET_BYTES
    return _LOST if large else ""


def _limit_s(topic: api.TopicSettings, silence_s: float) -> float:
    """The longest silence before a topic counts as silent; for a latched topic (rate 0) the configured silence."""
    least_s = silence_s if topic.silence is None else topic.silence
    return max(3 / topic.rate, least_s) if topic.rate else least_s


def _unit(topic: api.TopicSettings) -> str:
    return f"rates/{api.topic_id(topic.name)}"
