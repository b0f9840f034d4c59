"""Slot 6: the statuses that nodes publish on /diagnostics, for each configured name or pattern."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._ros_facts import full_name, snapshot
from phm_checks._status_publisher import name_pattern, named_publisher
from phm_checks._text import brief, clean, did_you_mean, listed, span

SETTLE_S = 1.5
"""Statuses come once a second by convention: a status that the next message corrects is not reported."""
GENERATION_S = 10.0
"""How often the engine is asked whether the container was restarted, while all statuses are OK."""
VALUES = 8
"""How many key-value pairs of the worst status the result keeps."""

_LEVELS = {0: Level.OK, 1: Level.WARN, 2: Level.ERROR}
_STALE_IS = {"error": Level.ERROR, "warn": Level.WARN, "stale": Level.STALE}


@dataclass(frozen=True)
class Watched:
    """One entry of `ros.diagnostics.watch`."""

    entry: api.WatchedDiagnosticSettings
    container: str
    node: str

    @property
    def unit(self) -> str:
        return f"diagnostics/{api.topic_id(self.entry.name)}"


@dataclass(frozen=True)
class EvaluatedStatus:
    """One status and its evaluation. `words`: what is wrong, e.g. `reports ERROR: no image`."""

    name: str
    fact: api.DiagnosticFact
    level: Level
    condition: str = ""
    words: str = ""
    short: str = ""

    @property
    def subject(self) -> str:
        return f"{clean(self.name, 120)}{_hardware(self.fact)}"


class Diagnostics(api.Check):
    """All watched statuses, one unit per entry with the worst status that matches it."""

    name, slot, layer = "diagnostics", Slot.NODES, Layer.ROS
    period_s = 1.0

    def __init__(self, watched: Sequence[Watched], grace_s: float) -> None:
        self._watched = tuple(watched)
        self._patterns = {item.unit: name_pattern(item.entry.name) for item in watched}
        self._grace_s = grace_s
        self._generations: dict[str, str] = {}
        self._began_s: dict[str, float] = {}
        self._asked_s: dict[str, float] = {}
        self._not_ok: dict[str, tuple[float, frozenset[str]]] = {}
        """By unit: the statuses that were not OK last, and when the run of the container began in which they were not."""

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        watched = []
        for entry in settings.ros.diagnostics.watch:
            node = full_name(entry.node) if entry.node else named_publisher(entry.name, settings)
            container = entry.container or settings.container_of_node(node)
            watched.append(Watched(entry, container, node))
        return [cls(watched, settings.ros.grace)] if watched else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return [self._as_unit(item) for item in self._watched]

    @property
    def wakes(self) -> frozenset[str]:
        keys = {item.container for item in self._watched if item.container}
        return frozenset({"ros", *(f"container:{key}" for key in keys)})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each unit; STALE for all without recent data from the ROS child process."""
        try:
            fact = snapshot(world)
        except api.CannotTell as reason:
            return {item.unit: api.stale(str(reason)) for item in self._watched}
        return {item.unit: self._judge(world, item, fact) for item in self._watched}

    def _as_unit(self, item: Watched) -> api.Unit:
        needs = (f"container/{item.container}", f"network/{item.container}") if item.container else ()
        if item.node:
            needs = (*needs, f"nodes/{api.topic_id(item.node)}")
        return api.Unit(
            item.unit,
            needs=needs,
            target=item.container,
            settle_s=SETTLE_S,
            grace_s=self._grace_s,
            memory_s=item.entry.timeout,
            node=item.node,
        )

    def _judge(self, world: api.World, item: Watched, fact: api.RosFact) -> api.Result:
        names = sorted(name for name in fact.diagnostics if self._patterns[item.unit].fullmatch(name))
        evaluated = [_evaluated(name, said, item.entry) for name in names for said in _sources(fact, name)]
        healthy = bool(evaluated) and all(one.level is Level.OK for one in evaluated)
        began_s = self._container_began(world, item.container, healthy)
        # A status received before the container restarted need not come again.
        ran_s = world.clock.mono() - began_s
        evaluated = [one for one in evaluated if one.fact.age_s <= ran_s]
        if not evaluated:
            return self._not_received(item, fact, ran_s)
        worst = max(evaluated, key=lambda one: one.level.severity)
        if worst.level is Level.OK:
            return self._ok(item, evaluated, began_s, early=self._early(item, fact, ran_s))
        found = _bad(worst, evaluated, item.container)
        self._not_ok[item.unit] = (began_s, frozenset(found.evidence.subjects or ()))
        return found

    def _early(self, item: Watched, fact: api.RosFact, ran_s: float) -> bool:
        """Whether a status may not have been received yet. `ran_s`: how long its container has run, if known."""
        return min(fact.up_s, ran_s) < self._grace_s or min(fact.listened_for_s, ran_s) < item.entry.timeout

    def _ok(self, item: Watched, evaluated: Sequence[EvaluatedStatus], began_s: float, *, early: bool) -> api.Result:
        """The result when all that were received are OK. A new ROS child or PHM may not have received yet what was not."""
        received = tuple(one.subject for one in evaluated)
        before_s, not_ok = self._not_ok.get(item.unit, (began_s, frozenset()))
        missing = sorted(not_ok.difference(received)) if early and before_s == began_s else []
        if missing:
            return api.stale(f"{listed(missing)}: not received again yet. {_ok_summary(evaluated)}")
        self._not_ok.pop(item.unit, None)
        found = api.ok(_ok_summary(evaluated), values={"received": len(evaluated)})
        return found.with_evidence(api.Evidence(subjects=received if early else None))

    def _not_received(self, item: Watched, fact: api.RosFact, ran_s: float) -> api.Result:
        """The result without any matching status. `ran_s`: how long its container has run, if known."""
        entry = item.entry
        if self._early(item, fact, ran_s):
            listened_s = min(fact.listened_for_s, ran_s)
            return api.stale(
                f"no status {clean(entry.name, 80)} received yet; PHM has listened for only {span(listened_s)}"
            )
        where = f" of {item.node}" if item.node else ""
        words = (
            f"no status {clean(entry.name, 80)} received on /diagnostics, expected from its node{where} at least every "
            f"{span(entry.timeout)}: check that it runs and that the name is right."
            f"{did_you_mean(entry.name, fact.diagnostics)}"
        )
        level = _STALE_IS[entry.when_stale]
        short = brief(entry.name, "not received")
        return api.Result(level, words, short, "diagnostic_stale", item.container, {"received": 0})

    def _container_began(self, world: api.World, container: str, healthy: bool) -> float:
        """When a restart of the container was last seen, on the monotonic clock; -inf for no restart."""
        now = world.clock.mono()
        if not container or (healthy and now - self._asked_s.get(container, float("-inf")) < GENERATION_S):
            return self._began_s.get(container, float("-inf"))
        self._asked_s[container] = now
        try:
            fact = world.docker.container(container)
        except api.CannotTell:
            fact = None
        if fact is not None and fact.generation != self._generations.get(container):
            if container in self._generations:
                self._began_s[container] = now
            self._generations[container] = fact.generation
        return self._began_s.get(container, float("-inf"))


def _sources(fact: api.RosFact, name: str) -> Sequence[api.DiagnosticFact]:
    """The newest status of each publisher that uses this name."""
    return fact.diagnostic_sources.get(name, (fact.diagnostics[name],))


def _evaluated(name: str, said: api.DiagnosticFact, entry: api.WatchedDiagnosticSettings) -> EvaluatedStatus:
    if said.age_s - said.not_counted_s > entry.timeout:
        words = f"has sent no status for {span(said.age_s)}, expected at least every {span(entry.timeout)}"
        return EvaluatedStatus(name, said, _STALE_IS[entry.when_stale], "diagnostic_stale", words, "silent")
    message = clean(said.message) or "no message"
    if said.level == 3:
        return EvaluatedStatus(
            name, said, _STALE_IS[entry.when_stale], "diagnostic_stale", f"reports STALE: {message}", "stale"
        )
    level = _LEVELS.get(said.level, Level.ERROR)
    if level is Level.OK:
        return EvaluatedStatus(name, said, level)
    # As in diagnostic_aggregator: an undefined level is an error.
    shown = level.name if said.level in _LEVELS else f"the unknown level {said.level}"
    return EvaluatedStatus(
        name, said, level, f"diagnostic_{level.name.lower()}", f"reports {shown}: {message}", level.name
    )


def _ok_summary(evaluated: Sequence[EvaluatedStatus]) -> str:
    if len(evaluated) == 1:
        return f"{clean(evaluated[0].name, 80)} reports OK: {clean(evaluated[0].fact.message) or 'no message'}"
    return f"{len(evaluated)} statuses report OK: {listed(one.name for one in evaluated)}"


def _bad(worst: EvaluatedStatus, evaluated: Sequence[EvaluatedStatus], container: str) -> api.Result:
    hardware = _hardware(worst.fact)
    others = [one.name for one in evaluated if one.level is not Level.OK and one is not worst]
    more = f" Also not OK: {listed(others)}." if others else ""
    theirs = {clean(key, 60): clean(value, 120) for key, value in list(worst.fact.values.items())[:VALUES]}
    values: dict[str, api.Value] = {
        **theirs,
        "status": clean(worst.name, 120),
        "hardware_id": clean(worst.fact.hardware_id, 120),
        "age_s": round(worst.fact.age_s, 1),
        "received": len(evaluated),
        "not_ok": len(others) + 1,
    }
    return api.Result(
        worst.level,
        f"{clean(worst.name, 120)} {worst.words}{hardware}; expected OK: check that node's log.{more}",
        brief(worst.name, worst.short),
        worst.condition,
        container,
        values,
        evidence=api.Evidence(subjects=tuple(one.subject for one in evaluated if one.level is not Level.OK)),
    )


def _hardware(fact: api.DiagnosticFact) -> str:
    return f" (hardware id {clean(fact.hardware_id, 60)})" if fact.hardware_id else ""
