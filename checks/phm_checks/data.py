"""Slot 8: the messages of topics with `data` have current stamps, changing content, no gaps, and values within their ranges."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._ros_facts import full_name
from phm_checks._text import StableNumber, brief, clean, joined, last, listed, span

SETTLE_S = 2.0
"""Gaps wait this long: if messages are not published at all, their rate shows it meanwhile, and is the cause."""
MEASURED_S = 1.0
"""The check runs once a second."""
ENOUGH = 2
"""A topic is not OK before this many messages were examined."""
AT_ONCE = 10.0
"""A stamp that differs by more than this many seconds is not one of a publisher that waits for a CPU."""
_UNDECIDED = {
    "data_stamp": "its stamps have not been examined for long enough",
    "data_frozen": "the content has not changed yet",
    "data_gaps": "too few numbers were examined for gaps",
}
CLOCK = "/clock"
DAY_S = 86_400.0


class Data(api.Check):
    """The examined messages of all topics with `data`, one unit each."""

    name, slot, layer = "data", Slot.RATES, Layer.ROS
    period_s = 1.0

    def __init__(
        self, topics: Sequence[api.TopicSettings], units: Sequence[api.Unit], places: Mapping[str, str]
    ) -> None:
        """places: the key of each topic's `data` in the configuration, by its name."""
        self._topics = tuple((topic, topic.data) for topic in topics if topic.data is not None)
        self._units = tuple(units)
        self._targets = {unit.id: unit.target for unit in units}
        self._places = dict(places)
        self._numbers = StableNumber(share=0.1)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        topics = [topic for topic in settings.ros.topics if topic.data is not None]
        units = [
            api.Unit(
                _unit(topic),
                needs=(f"rates/{api.topic_id(topic.name)}",),
                target=settings.container_of_topic(topic),
                grace_s=settings.ros.grace,
                memory_s=(settings.ros.silence if topic.silence is None else topic.silence) + MEASURED_S,
                node=next(map(full_name, topic.publishers), ""),
            )
            for topic in topics
        ]
        places = {topic.name: f"ros.topics[{index}].data" for index, topic in enumerate(settings.ros.topics)}
        return [cls(topics, units, places)] if topics else []

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
            return {_unit(topic): api.stale(str(reason)) for topic, _ in self._topics}
        return {_unit(topic): self._judge(topic, data, fact) for topic, data in self._topics}

    def _judge(self, topic: api.TopicSettings, data: api.DataSettings, fact: api.RosFact) -> api.Result:
        name = api.topic_id(topic.name)
        seen = fact.topics.get(f"/{name}", api.TopicFact())
        found = seen.data
        if seen.rate is not None and (seen.rate.hz == 0.0 or seen.rate.problem):
            return api.stale(f"{name} has no messages to examine: {_no_messages(seen.rate)}")
        if found is None or (found.samples < ENOUGH and not found.problem):
            return api.stale(f"no messages of {name} were examined yet")
        results = self._results(topic, data, found, simulated=_simulated(fact))
        if found.problem:
            where = self._places[topic.name]
            results.append(api.stale(f"{name}: {where} cannot be examined completely: {clean(found.problem, 400)}"))
        values = _values(found)
        if not results and found.undecided:
            return _not_yet(name, data, found, values)
        if not results:
            for key in (name, f"{name} gaps"):
                self._numbers.forget(key)
            return replace(api.ok(f"{name}: {_summary(data, found)}"), values=values)
        worst = api.worst(results)
        others = [result.summary for result in results if result is not worst]
        summary = joined([worst.summary, *others]) if others else worst.summary
        return replace(worst, summary=summary, values=values)

    def _results(
        self, topic: api.TopicSettings, data: api.DataSettings, found: api.DataFact, *, simulated: bool
    ) -> list[api.Result]:
        judges: Mapping[str, Callable[[], api.Result]] = {
            "data_stamp": lambda: self._stamp(topic, data, found, simulated=simulated),
            "data_frozen": lambda: self._frozen(topic, data, found),
            "data_range": lambda: self._range(topic, data, found),
            "data_gaps": lambda: self._gaps(topic, data, found),
            "data_order": lambda: self._order(topic, found),
        }
        return [judge() for condition, judge in judges.items() if condition in found.conditions]

    def _stamp(
        self, topic: api.TopicSettings, data: api.DataSettings, found: api.DataFact, *, simulated: bool
    ) -> api.Result:
        name, age_s = api.topic_id(topic.name), found.age_s or 0.0
        if simulated:
            return api.stale(
                f"{name}: the age of its stamps cannot be judged: {CLOCK} is published, so its nodes may use simulated time; "
                "remove data.max_age for simulations"
            )
        if found.unset:
            return self._bad(
                topic,
                "data_stamp",
                "stamp not set",
                f"{name}: header.stamp is not set (0): its node must set it before it publishes",
                conclusive=True,
            )
        late = age_s > 0
        shown = _span(self._numbers.show(name, abs(age_s)))
        return self._bad(
            topic,
            "data_stamp",
            f"stamp {shown} {'old' if late else 'ahead'}",
            f"{name}: its stamps are {_span(abs(age_s))} {'old' if late else 'in the future'}, allowed is {span_of(data.max_age)}: "
            + ("its messages wait before they are published, or " if 0 < age_s <= DAY_S else "")
            + "the clock of its source differs from the clock of this computer; check time synchronization",
            conclusive=not 0 < age_s <= AT_ONCE,
        )

    def _order(self, topic: api.TopicSettings, found: api.DataFact) -> api.Result:
        """A single step, e.g. of a clock that was set, is a WARN."""
        name, again = api.topic_id(topic.name), found.backs > 1
        return self._bad(
            topic,
            "data_stamp",
            "stamps go back",
            f"{name}: its stamps go back, by {_span(found.back_s)}"
            + (
                f", {found.backs} times in the last messages examined: several sources, or messages out of order"
                if again
                else ": the clock of its source was set"
            ),
            level=Level.ERROR if again else Level.WARN,
            conclusive=True,
        )

    def _frozen(self, topic: api.TopicSettings, data: api.DataSettings, found: api.DataFact) -> api.Result:
        name = api.topic_id(topic.name)
        return self._bad(
            topic,
            "data_frozen",
            "frozen",
            f"{name}: frozen. Messages have had the same content for {span(found.frozen_s)}, allowed is {span_of(data.frozen)}: "
            "its source repeats old data; check the sensor or input of its node",
            conclusive=True,
        )

    def _range(self, topic: api.TopicSettings, data: api.DataSettings, found: api.DataFact) -> api.Result:
        name = api.topic_id(topic.name)
        fields = [
            f"{outside.field} is {clean(outside.value, 40)}, allowed is {_allowed(data.ranges.get(outside.field, []))}"
            for outside in found.outside
        ]
        what = last(found.outside[0].field.replace(".", "/")) if found.outside else ""
        return self._bad(
            topic,
            "data_range",
            f"{what} out of range",
            f"{name}: {'; '.join(fields)}: check the sensor or input of its node",
            conclusive=True,
        )

    def _gaps(self, topic: api.TopicSettings, data: api.DataSettings, found: api.DataFact) -> api.Result:
        name, lost = api.topic_id(topic.name), found.lost_percent or 0.0
        result = self._bad(
            topic,
            "data_gaps",
            f"{self._numbers.show(f'{name} gaps', lost):.0f} % lost",
            f"{name}: {lost:.0f} % of the numbers in {data.counter} are missing, allowed is {data.gaps:g} %: messages are lost "
            "before they are published; check the input and the load of its node",
            level=Level.ERROR if lost > 2 * data.gaps else Level.WARN,
        )
        return replace(result, settle_s=SETTLE_S)

    def _bad(
        self,
        topic: api.TopicSettings,
        condition: str,
        short: str,
        words: str,
        *,
        level: Level = Level.ERROR,
        conclusive: bool = False,
    ) -> api.Result:
        target = self._targets[_unit(topic)]
        result = api.Result(level, words, brief(last(topic.name), short), condition, target)
        return result.with_evidence(api.Evidence(conclusive=conclusive))


def _unit(topic: api.TopicSettings) -> str:
    return f"data/{api.topic_id(topic.name)}"


def _not_yet(name: str, data: api.DataSettings, found: api.DataFact, values: Mapping[str, api.Value]) -> api.Result:
    """A new publisher, or a new ROS child process, may repeat what was wrong before: that it is not known yet does not end a
    fault."""
    words = listed(_UNDECIDED.get(condition, condition) for condition in found.undecided)
    frozen_s = data.frozen if "data_frozen" in found.undecided else None
    return replace(api.stale(f"{name} is not decided yet: {words}", values=values), decides_s=frozen_s)


def _simulated(fact: api.RosFact) -> bool:
    """Whether simulated time is published. Its nodes may use it, and then only they know the age of a stamp."""
    configured = fact.topics.get(CLOCK)
    other = fact.others.get(CLOCK)
    return bool(configured and configured.publishers) or bool(other and other.publishers)


def _no_messages(rate: api.RateFact) -> str:
    return clean(rate.problem) or "it is silent"


def _summary(data: api.DataSettings, found: api.DataFact) -> str:
    """The part of the summary that lists what was examined and is OK."""
    parts = []
    if found.age_s is not None and data.max_age is not None:
        parts.append(f"stamps {_span(abs(found.age_s))} {'old' if found.age_s >= 0 else 'ahead'}")
    if data.order:
        parts.append("in order")
    if data.frozen is not None:
        parts.append("content changes")
    if found.lost_percent is not None:
        parts.append(f"{found.lost_percent:.0f} % lost")
    if data.ranges:
        parts.append("values within their ranges")
    return ", ".join(parts) or "nothing is configured to be examined"


def _values(found: api.DataFact) -> dict[str, api.Value]:
    values: dict[str, api.Value] = {
        "age_s": found.age_s,
        "backs": found.backs,
        "frozen_s": found.frozen_s,
        "lost_percent": found.lost_percent,
        "samples": found.samples,
    }
    if found.outside:
        values["outside"] = ", ".join(f"{outside.field}={clean(outside.value, 40)}" for outside in found.outside)
    return values


def _span(seconds: float) -> str:
    """Also small and very large durations."""
    if seconds < 0.1:
        return f"{1000 * seconds:.0f} ms"
    if seconds < 2 * 3600:
        return span(seconds)
    return f"{seconds / 3600:.0f} h" if seconds < 2 * DAY_S else f"{seconds / DAY_S:.0f} d"


def span_of(limit_s: float | None) -> str:
    return "unlimited" if limit_s is None else f"{limit_s:g} s"


def _allowed(limits: Sequence[float | None]) -> str:
    low, high = limits if len(limits) == 2 else (None, None)
    if low is None:
        return f"{high:g} or less" if high is not None else "any number"
    return f"{low:g} or more" if high is None else f"{low:g} to {high:g}"
