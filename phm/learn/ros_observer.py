"""Watches the ROS graph for `phm learn`: first what is there, then the rates of its topics."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace

from phm.core.clock import Clock
from phm.core.settings import DiagnosticsSettings, NodeReadySettings, NodeSettings, RosSettings, TopicSettings
from phm.facts import CannotTell, EndpointFact, RosFact
from phm.learn.observations import Observations, ObservedTopic
from phm.probes.ros.supervisor import RosSupervisor

STABLE_S = 5.0
"""Discovery is complete when nothing has changed for this long."""
DISCOVERY_S = 40.0
START_S = 30.0
"""After this the ROS child must have reported."""
WINDOW_HZ = 1.0
"""Rates are measured as if this was expected, so over a few seconds."""
_OWN = ("/_phm", "/phm")
_LEFT_OUT = ("/diagnostics", "/diagnostics_agg", "/diagnostics_toplevel_state")
"""Topics that PHM reads or publishes itself; what is on them is not a stream with a rate."""
_TURN_S = 0.25


@dataclass(slots=True)
class _Samples:
    rates: list[float] = field(default_factory=list)
    error_hz: float = 0.0
    silent: bool = False
    samples: int = 0
    problem: str = ""
    publishers: tuple[EndpointFact, ...] = ()
    subscribers: tuple[EndpointFact, ...] = ()
    changed: bool = False


class RosObserver:
    """Call `discover`, then `tick` a few times a second, then `into`."""

    def __init__(self, settings: RosSettings, agent: str, clock: Clock) -> None:
        """agent: its name."""
        self._settings, self._agent, self._clock = settings, agent, clock
        self._probe: RosSupervisor | None = None
        self._problems: list[str] = []
        self._watched = False
        self._nodes: dict[str, bool] = {}
        self._states: dict[str, set[str]] = {}
        """The states that each lifecycle node had."""
        self._topics: dict[str, _Samples] = {}
        self._late: set[str] = set()
        self._others: set[str] = set()
        self._next_s = 0.0

    def discover(self) -> None:
        """Find nodes and topics, then begin to measure the topics' rates."""
        fact = self._stable()
        if fact is None:
            return
        self._watched = True
        self._others = {name for name in fact.others if _own(name)}
        topics = sorted(name for name, users in fact.others.items() if users.publishers and not _own(name))
        self._nodes = {name: True for name in sorted(fact.nodes) if not _hidden(name)}
        self._topics = {name: _Samples() for name in topics}
        self._start(topics, sorted(self._nodes))
        self._first()

    def tick(self) -> None:
        """Read the newest picture, once a second."""
        now_s = self._clock.mono()
        if self._probe is None or now_s < self._next_s:
            return
        self._next_s = now_s + 1.0
        try:
            fact = self._probe.snapshot()
        except CannotTell as reason:
            self._problem(f"ROS was not watched all the time: {reason}")
            return
        for name in self._nodes:
            self._nodes[name] = fact.nodes.get(name, 0) > 0
        self._nodes |= {name: False for name in fact.nodes if name not in self._nodes and not _hidden(name)}
        for name, state in fact.lifecycle.items():
            self._states.setdefault(name, set()).add(state.answer)
        self._late |= {name for name, users in fact.others.items() if users.publishers and not _own(name)}
        for name, samples in self._topics.items():
            self._take(samples, fact, name)

    def into(self, seen: Observations) -> Observations:
        topics = tuple(
            ObservedTopic(
                name,
                one.publishers,
                one.subscribers,
                tuple(one.rates),
                one.error_hz,
                one.silent,
                one.samples,
                one.problem,
                one.changed,
            )
            for name, one in self._topics.items()
            if one.publishers
        )
        if self._watched and not self._nodes:
            self._problem("no ROS node was found: compare ROS_DOMAIN_ID and networks with `phm doctor`")
        return replace(
            seen,
            ros_watched=self._watched,
            nodes=dict(self._nodes),
            active_nodes=frozenset(name for name, states in self._states.items() if states - {""} == {"active"}),
            topics=topics,
            late_topics=tuple(sorted(self._late)),
            other_topics=tuple(sorted(self._others)),
            problems=(*seen.problems, *self._problems),
        )

    def close(self) -> None:
        if self._probe is not None:
            self._probe.close()
            self._probe = None

    # ------------------------------------------------------------ parts

    def _take(self, samples: _Samples, fact: RosFact, name: str) -> None:
        topic = fact.topics.get(name)
        if topic is None:
            return
        ends = (_named(topic.publishers), _named(topic.subscribers))
        if samples.publishers and ends != (samples.publishers, samples.subscribers):
            samples.changed = samples.changed or not ends[0]
        if ends[0]:
            samples.publishers, samples.subscribers = ends
        rate = topic.rate
        if rate is None:
            return
        samples.samples = max(samples.samples, rate.samples)
        if rate.problem:
            samples.problem = rate.problem
        if rate.hz is not None:
            samples.rates.append(rate.hz)
            samples.silent = samples.silent or rate.hz == 0.0
            samples.error_hz = max(samples.error_hz, rate.error_hz or 0.0)

    def _stable(self) -> RosFact | None:
        """The picture once it has not changed for STABLE_S."""
        self._start([], [])
        pause, began_s = threading.Event(), self._clock.mono()
        known: object = None
        since_s, fact, why = began_s, None, ""
        while (now_s := self._clock.mono()) < began_s + DISCOVERY_S:
            try:
                assert self._probe is not None
                fact = self._probe.snapshot()
            except CannotTell as reason:
                why = str(reason)
                if now_s - began_s > START_S and fact is None:
                    break
            else:
                shown = (sorted(fact.nodes), dict(fact.others))
                if shown != known:
                    known, since_s = shown, now_s
                if now_s - since_s >= STABLE_S and fact.up_s >= self._settings.grace:
                    return fact
            self._clock.wait(pause, _TURN_S)
        if fact is None:
            self._problem(f"ROS was not watched: {why}")
            self.close()
        else:
            self._problem(
                f"the ROS graph still changed after {DISCOVERY_S:.0f} s: watch again when the agent has started"
            )
        return fact

    def _first(self) -> None:
        """Wait until the new child has measured something, so that all of the watch counts."""
        pause, end_s = threading.Event(), self._clock.mono() + START_S
        while self._clock.mono() < end_s and self._probe is not None:
            try:
                fact = self._probe.snapshot()
                rates = [topic.rate for topic in fact.topics.values()]
                waits = [rate for rate in rates if rate is None or (rate.hz is None and rate.samples)]
                if len(rates) == len(self._topics) and not waits and fact.up_s >= self._settings.grace:
                    return
            except CannotTell:
                pass
            self._clock.wait(pause, _TURN_S)

    def _start(self, topics: list[str], nodes: list[str]) -> None:
        self.close()
        ros = self._settings.model_copy(
            update={
                "topics": [TopicSettings(name=name, rate=WINDOW_HZ, silence=60.0) for name in topics],
                # Only a lifecycle node has the service that is called for this.
                "nodes": [NodeSettings(name=name, ready=NodeReadySettings(lifecycle="active")) for name in nodes],
                "diagnostics": DiagnosticsSettings(publish=False, listen=[]),
            }
        )
        name = f"{self._agent}_learn"
        self._probe = RosSupervisor(ros, name, self._clock, lambda: None, lambda text: None)
        self._probe.start()

    def _problem(self, text: str) -> None:
        if text not in self._problems:
            self._problems.append(text)


def _named(ends: tuple[EndpointFact, ...]) -> tuple[EndpointFact, ...]:
    return tuple(
        sorted((end for end in ends if end.node and not _hidden(end.node)), key=lambda end: (end.node, end.type))
    )


def _hidden(node: str) -> bool:
    """Whether a node belongs to a tool or to PHM."""
    return "/_" in node or node.startswith(_OWN)


def _own(topic: str) -> bool:
    return topic in _LEFT_OUT or topic.startswith("/phm/")
