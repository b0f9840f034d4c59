"""A simulated agent for the tracker: what each unit would report, when, and which action repairs it.

A fault begins at one moment; its evidence reaches the units later or, for dependents, even earlier than that of the
cause. The bounds below are the assumptions of the tracker's guarantee; everything else (which check runs when, how long
a run takes, which wake-ups are lost) is random.

- A cause is detected by any run of its own check that starts at or after the moment of the fault. Its event may be lost.
- Nodes are judged dead from 0.05 s (they say goodbye up to 0.25 s before, and their check waits for 0.3 s) to 2 s after
  the fault (the lease of `config/fastdds.xml` ends).
- The endpoints of a topic disappear from 1 s before to 1 s after their node; `settle_s` of topics is 1.5 s.
- A topic is silent 0.5 s after the fault at the earliest; `settle_s` of rates is 2 s, so it is never reported before its
  node is known to be missing. If its node has been alive since, it may be reported immediately: no death caused it.
- After a repair nodes are back within 5 s, topics 1 s and rates 3 s later: each within its grace of 8 s. A killed node
  may stay listed for another second after its container has started again (a stale name).
- While the engine does not respond, the container's cgroup shows that it has ended or is frozen, and nothing else of it is known.
- Pressure shows starvation no later than the first of its symptoms, in any run of its check that starts from then on; the
  machine's does so up to 1.5 s after that of a container which waits for CPUs. Symptoms are gone 4.5 s after its end.
  The healthcheck probes on its own schedule, reports when it did, and restarts with each start of the container.
- A run takes 0.2 s at most, a wake-up that is not lost is served within 0.9 s.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from random import Random

from phm import testing
from phm.checking import plan, registry
from phm.checking.plan import CheckPlan
from phm.config import load
from phm.core.model import Event, Evidence, FaultClosed, FaultOpened, Level, Result, Stamp, Transition
from phm.core.settings import Settings
from phm.facts import ContainerFact
from phm.tracker import Effects, Tracker
from phm.tracker.rules import DETACHED, FROM_OUTSIDE, GRACE_ENDS_AFTER_OK_S, RECONNECTS
from phm.tracker.starvation import UNREAD_S
from phm_checks.container import WITHOUT_ENGINE_S

ROOT = Path(__file__).resolve().parents[2]
TARGET = "ros_app"
TICK_S = 0.1
SILENCE_S = 0.5
PROBING_S = 5.0
"""After a start, the engine says `starting` until so many probes in a row have failed that the container is unhealthy."""
OK = Result(Level.OK, "healthy")
NODES = {n: f"nodes/agent_1/node_{n}" for n in (1, 2, 3)}
TOPICS = {n: f"topics/agent_1/topic_{n}" for n in (1, 2, 3)}
RATES = {n: f"rates/agent_1/topic_{n}" for n in (1, 2, 3)}
CAUSES = {
    "container": ("container/ros_app", "exited"),
    "paused": ("container/ros_app", "paused"),
    "unhealthy": ("health/ros_app", "unhealthy"),
    "network": ("network/ros_app", "disconnected"),
    "apart": ("network/ros_app", "sidecar_disconnected"),
    "file": ("files/ros_app", "file_missing"),
    "device": ("devices/ros_app", "device_missing"),
    "disk": ("host/disk", "disk_full"),
    "engine": ("engine", "unreachable"),
    **{f"node_{n}": (NODES[n], "node_missing") for n in NODES},
    **{f"silent_{n}": (RATES[n], "topic_silent") for n in RATES},
    "quorum": ("consensus", "quorum_dead"),
    "starved": ("pressure/ros_app", "cpu_throttled"),
    "overload": ("host/cpu", "cpu_high"),
}
"""Primary faults: the unit that is the cause, and its condition."""
LINKS = (("autopilot", "autopilot_silent"), ("gcs", "gcs_lost"), ("link/ground", "link_silent"))
STARVING = frozenset({"starved", "overload"})
HIDDEN = frozenset({"unhealthy", "quorum", *(kind for kind in CAUSES if kind.startswith("silent"))})
"""What cannot be known while the container is starved: it would look the same without its own cause."""
FIXES = {
    "start": {"container"},
    "unpause": {"paused"},
    "reconnect": {"network"},
    "join_network": {"apart"},
    "restore_file": {"file"},
    "relaunch": {"node_1", "node_2", "node_3", "silent_1", "silent_2", "silent_3"},
    "restart": set(CAUSES) - {"file", "device", "disk", "engine", "apart", *STARVING},
}
UNEXPLAINED = CAUSES.keys() - HIDDEN - {"overload"}
"""Whose process is gone: starvation does not explain it."""
LOST = "lost"
"""Not a cause: nodes that a repair has left cut off."""
BY_ENGINE = ("container/", "health/", "files/", "network/")
"""Units whose state is unknown while the engine does not respond."""


@cache
def shipped() -> tuple[Settings, CheckPlan]:
    """The shipped configuration and its plan, made from the installed checks."""
    settings = load(str(ROOT / "config" / "phm.yaml"), environ={})
    return settings, plan.build_plan(settings, registry.checks())


@cache
def targeted() -> frozenset[str]:
    """Units of the container."""
    return frozenset(entry.unit.id for entry in shipped()[1].tracked if entry.unit.target == TARGET)


@dataclass(slots=True)
class Bad:
    """A span in which `unit` is reported as bad; `back_s` after the repair it is OK."""

    unit: str
    begin: float
    condition: str
    back_s: float
    end: float = float("inf")

    def covers(self, at: float) -> bool:
        return self.begin <= at < self.end


@dataclass(frozen=True, slots=True)
class Life:
    """The container was started `at`; its id and its restart count show who started it."""

    at: float
    number: int
    made: int = 0
    restarts: int = 0


@dataclass(slots=True)
class World:
    """The truth over time: spans in which units are bad, generations of the container, and faults without repair."""

    random: Random
    bad: dict[str, list[Bad]] = field(default_factory=dict)
    active: dict[str, list[Bad]] = field(default_factory=dict)
    stale_names: list[tuple[float, float]] = field(default_factory=list)
    lives: list[Life] = field(default_factory=lambda: [Life(float("-inf"), 0)])
    sure: bool = True
    """Whether checks find evidence that cuts settling short."""
    cgroups: bool = True
    """Whether PHM sees the container's cgroup, also while the engine does not respond."""

    def inject(self, kind: str, at: float) -> None:
        """Begin a primary fault `at`, with all its consequences."""
        unit, condition = CAUSES[kind]
        rnd, spans = self.random, []
        family, _, number = kind.partition("_")
        first = at + rnd.uniform(SILENCE_S, SILENCE_S + 0.5) if family == "silent" else at
        spans.append(Bad(unit, first, condition, rnd.uniform(0.3, 5.0) if family == "node" else 0.0))
        if kind in STARVING:
            spans += self._symptoms(at, kind)
        elif family in ("container", "paused", "network", "apart", "node"):
            spans += self._ros(at, {int(number)} if family == "node" else set(NODES), spans[0], family)
        self.active[kind] = spans
        for span in spans:
            self.bad.setdefault(span.unit, []).append(span)

    def _ros(self, at: float, nodes: set[int], cause: Bad, family: str) -> Iterable[Bad]:
        rnd = self.random
        own = family == "node"
        gone = {
            n: cause.begin if own else at + rnd.choice((rnd.uniform(0.05, 0.5), rnd.uniform(0, 2.0))) for n in nodes
        }
        back = {n: cause.back_s if own else rnd.uniform(0.3, 5.0) for n in nodes}
        if not own:
            yield from (Bad(NODES[n], gone[n], "node_missing", back[n]) for n in nodes)
        for n in TOPICS:
            ends = [m for m in (n, n % 3 + 1) if m in nodes]  # its publisher and its subscriber
            if ends:
                # A topic depends on all its nodes: evidence may precede the first of them, not its cause's settling.
                begin = min(gone[m] for m in ends) + rnd.uniform(-1.0, 1.0)
                topic_back = max(back[m] for m in ends) + rnd.uniform(0.0, 1.0)
                yield Bad(TOPICS[n], begin, "publisher_missing", topic_back)
                if n in nodes:
                    silent = max(at, min(gone.values())) + rnd.uniform(SILENCE_S, SILENCE_S + 1.0)
                    yield Bad(RATES[n], silent, "topic_silent", topic_back + rnd.uniform(0.0, 3.0))

    def _symptoms(self, at: float, kind: str) -> Iterable[Bad]:
        """Some of the symptoms that starvation explains, each at its own moment."""
        rnd = self.random
        may = [(unit, rnd.choice(("topic_silent", "rate_low"))) for unit in RATES.values()]
        may += [(unit, rnd.choice(("node_hung", "node_missing", "node_unanswering"))) for unit in NODES.values()]
        may += [(unit, rnd.choice(("publisher_lost", "topic_missing"))) for unit in TOPICS.values()]
        may += [("health/ros_app", "unhealthy")]
        if kind == "overload":
            for unit, condition in LINKS:
                if rnd.random() < 0.6:  # for a while only: PHM excludes the time in which it was late itself
                    begin = at + rnd.choice((0.0, rnd.uniform(0.0, 6.0)))
                    yield Bad(unit, begin, condition, 0.0, begin + rnd.uniform(0.5, UNREAD_S - 5.0))
            if rnd.random() < 0.7:
                yield Bad("pressure/ros_app", at - rnd.uniform(0.0, 1.5), "cpu_starved", rnd.uniform(0.0, 3.0))
        for unit, condition in may:
            if rnd.random() < 0.6:
                yield Bad(unit, at + rnd.choice((0.0, rnd.uniform(0.0, 6.0))), condition, rnd.uniform(0.2, 4.5))

    def repair(self, kind: str, at: float) -> None:
        """End the primary fault; its consequences end one after the other."""
        for span in self.active.pop(kind, ()):
            span.end = min(span.end, max(span.begin, at + span.back_s))
        if kind in ("container", "paused"):
            self.stale_names.append((at, at + self.random.uniform(0.0, 1.0)))

    def repair_in_part(self, kind: str, at: float) -> None:
        """End the cause; its consequences stay lost until the container is restarted."""
        cause, *rest = self.active.pop(kind)
        cause.end = max(cause.begin, at)
        if rest:
            self.active.setdefault(LOST, []).extend(rest)

    def restart(self, at: float, by: str = "phm") -> float:
        """Stop and start the container, or recreate it; return when it runs again.

        by: phm, hand, policy (by the engine, after the process has terminated) or recreate.
        """
        up = at + self.random.uniform(0.2, 1.0)
        for kind in ("container", "paused", LOST):
            self.repair(kind, at)
        self.inject("container", at)
        if by == "policy":
            self.active["container"][0].condition = "restarting"
        self.repair("container", up)
        self.record_start(up, by)
        return up

    def record_start(self, at: float, by: str = "phm") -> None:
        last = self.lives[-1]
        restarts = last.restarts + 1 if by == "policy" else 0
        self.lives.append(Life(at, last.number + 1, last.made + (by == "recreate"), restarts))

    def fact(self, at: float) -> ContainerFact:
        """What the engine reports about the container."""
        life, span = self._life(at), self._first(f"container/{TARGET}", at)
        status, start = span.condition if span is not None else "running", f"t{life.number:06}"
        return testing.container(
            TARGET, id=f"id{life.made}", started_at=start, restart_count=life.restarts, status=status
        )

    def _life(self, at: float) -> Life:
        return next(life for life in reversed(self.lives) if life.at <= at)

    def _running_since(self, at: float) -> float:
        down = self.bad.get(f"container/{TARGET}", ())
        ends = [span.end for span in down if span.end <= at and span.condition in ("exited", "restarting")]
        return max([self._life(at).at, *ends])

    def result(self, unit: str, at: float) -> Result:
        """The result of a run of the unit's check at `at`."""
        if unit.startswith(BY_ENGINE) and (away := self._first("engine", at)) is not None:
            seen = self._by_cgroup(away.begin, at) if unit == f"container/{TARGET}" else None
            return seen or Result(Level.STALE, "the engine does not answer")
        if unit in ("network/ros_app", "health/ros_app", "pressure/ros_app") and self._is_bad("container/ros_app", at):
            return Result(Level.STALE, "not judged while the container does not run")
        if self._is_stale_name(unit, at):
            return OK
        generation = self.fact(at).generation if unit == f"container/{TARGET}" else ""
        found = [span for span in self.bad.get(unit, ()) if span.covers(at)]
        if not found:
            return Result(Level.OK, "healthy", evidence=Evidence(generation)) if generation else OK
        target = TARGET if unit in targeted() else ""
        probing_s = self._running_since(at) + PROBING_S - at
        if unit.startswith("health/") and probing_s > 0:
            return Result(Level.STALE, "starting", target=target, decides_s=PROBING_S)
        span = next(filter(self._conclusive, found), found[0])
        if span.condition == "restarting":
            return Result(Level.STALE, "the engine is about to restart it", evidence=Evidence(generation))
        condition = span.condition
        sure = 0.0 if self._surely_silent(span) else None
        # The engine's probes come every few seconds: the newest was at one of the moments, or started this one.
        age_s = (at - span.begin) % 30.0 if unit.startswith("health/") else 0.0
        return Result(
            Level.ERROR,
            f"{unit} {condition}",
            condition,
            condition,
            target,
            settle_s=sure,
            age_s=age_s,
            evidence=Evidence(generation, conclusive=not generation and self._conclusive(span)),
        )

    def _by_cgroup(self, away_from: float, at: float) -> Result | None:
        """What `phm_checks.container` finds without the engine; None: that the container runs, or nothing."""
        span, before = self._first(f"container/{TARGET}", at), self.fact(away_from)
        replaced = before.id != self.fact(at).id
        if not self.cgroups or (span is None and not replaced):
            return None
        paused = span is not None and span.condition == "paused" and not replaced
        same, new = ("paused", "frozen") if paused else ("exited", "ended")
        found, seen = same if before.status == same else new, Evidence(certain=True, conclusive=True)
        return Result(Level.ERROR, found, found, found, TARGET, settle_s=WITHOUT_ENGINE_S, evidence=seen)

    def _conclusive(self, span: Bad) -> bool:
        """A primary fault that starvation does not explain: its process is gone."""
        return any(spans and spans[0] is span for kind, spans in self.active.items() if kind in UNEXPLAINED)

    def _surely_silent(self, span: Bad) -> bool:
        """The node has been alive since; every second node has no evidence of that."""
        primary = self.sure and any(span in spans for kind, spans in self.active.items() if kind.startswith("silent"))
        return primary and int(span.begin * 1000) % 2 == 0

    def _is_stale_name(self, unit: str, at: float) -> bool:
        """Still listed; a node that was missing before the container stopped leaves no stale name."""
        if not unit.startswith(("nodes/", "topics/")) or not any(begin <= at < end for begin, end in self.stale_names):
            return False
        return not any(span.covers(at) for spans in self.active.values() for span in spans if span.unit == unit)

    def _first(self, unit: str, at: float) -> Bad | None:
        return next((span for span in self.bad.get(unit, ()) if span.covers(at)), None)

    def _is_bad(self, unit: str, at: float) -> bool:
        return self._first(unit, at) is not None

    def changing(self, begin: float, end: float) -> set[str]:
        """The units of which something changes in that time. Only those that are bad at some time, and the health."""
        changing = {
            span.unit
            for spans in self.bad.values()
            for span in spans
            if begin <= span.begin < end or begin <= span.end < end
        }
        starts = (*(life.at for life in self.lives), *(span.end for span in self.bad.get(f"container/{TARGET}", ())))
        if any(begin <= start + PROBING_S < end for start in starts):
            changing.add(f"health/{TARGET}")
        return changing


class Sim:
    """Scheduler, tracker and clock in one thread. `events` has what the bus would publish."""

    def __init__(self, seed: int, *, warm: bool = True, wakes_lost: float = 0.3) -> None:
        self.settings, self.plan = shipped()
        self.random = Random(seed)
        self.world = World(self.random)
        self.now = 0.0
        self.tracker = Tracker(self.plan.tracked, self.plan.graph, self.stamp())
        self.events: list[tuple[float, Event]] = []
        self.listeners: list[Callable[[Event], None]] = []
        self.watch: list[Callable[[], None]] = []
        self.wakes_lost = wakes_lost
        self.held, self.held_until = "", 0.0
        self.reset_units: list[str] = []
        self.granted: dict[str, float] = {entry.unit.id: 0.0 for entry in self.plan.tracked}
        self.healthy_from: dict[str, float] = {}
        self.sure: dict[str, float] = {}
        self.touched = targeted().union(*(self.tracker.graph.downstream(unit) for unit in targeted()))
        self._graces = {entry.unit.id: entry.unit.grace_s for entry in self.plan.tracked}
        self._checks = [entry.units for entry in self.plan.scheduled]
        self._periods = [entry.period_s for entry in self.plan.scheduled]
        self._of_unit = {unit: index for index, units in enumerate(self._checks) for unit in units}
        self._next = [self.random.uniform(0, 0.3) for _ in self._checks]
        self._busy = [False] * len(self._checks)
        self._deliveries: list[tuple[float, int, float, dict[str, Result]]] = []
        if warm:
            self._warm_up()

    def stamp(self) -> Stamp:
        return Stamp(1e9 + self.now, self.now)

    def _warm_up(self) -> None:
        """Let everything be OK for long enough that grace is over."""
        for _ in range(2):
            for unit in self._of_unit:
                self._observe(unit, OK, self.now)
            self.now += GRACE_ENDS_AFTER_OK_S + 0.1
        self._next = [self.now + self.random.uniform(0, period) for period in self._periods]
        for unit in self._of_unit:
            self._observe(unit, OK, self.now)

    # ------------------------------------------------------------ time

    def run(self, seconds: float) -> None:
        """Advance the time, with every result and every tick in its order."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            tick = self.now + TICK_S
            self._wake_on_changes(self.now, tick)
            while True:
                begins = min(self._next)
                delivered = self._deliveries[0][0] if self._deliveries else tick
                if min(begins, delivered) >= tick:
                    break
                if begins < delivered:
                    self._begin(self._next.index(begins), begins)
                else:
                    self._deliver()
            self.now = tick
            self.take(self.tracker.tick(self.stamp()))
            for observe in self.watch:
                observe()
            self._assert_visible()

    def _assert_visible(self) -> None:
        """A unit in ERROR always has a fault that an operator can see, open or given up."""
        hidden = self.units_at(Level.ERROR)
        if hidden:
            hidden -= {fault.unit for fault in (*self.tracker.open_faults(), *self.tracker.given_up())}
        assert not hidden, f"in ERROR without a fault at {self.now:.1f}: {hidden}"

    def _begin(self, index: int, at: float) -> None:
        took = self.random.uniform(0.001, 0.2)
        looked = at + self.random.random() * took
        results = {unit: self.world.result(unit, looked) for unit in self._checks[index]}
        heapq.heappush(self._deliveries, (at + took, index, at, results))
        self._next[index] = float("inf")
        self._busy[index] = True

    def _deliver(self) -> None:
        at, index, started, results = heapq.heappop(self._deliveries)
        self.now = max(self.now, at)
        self._busy[index] = False
        self._next[index] = min(self._next[index], at + max(0.05, self._periods[index]))
        for unit, result in results.items():
            self._observe(unit, result, started)

    def _wake_on_changes(self, begin: float, end: float) -> None:
        changed = {self._of_unit[unit] for unit in self.world.changing(begin, end) if unit in self._of_unit}
        for index in sorted(changed):
            if self.random.random() >= self.wakes_lost:
                self._wake(index, 0.1)
        for life in self.world.lives:
            if begin <= life.at < end and self.random.random() >= self.wakes_lost:
                self.take(self.tracker.container_started(TARGET, self.stamp()))

    def _wake(self, index: int, within_s: float) -> None:
        after = self.now + self.random.uniform(0.0, within_s)
        if self._busy[index]:
            after += 0.2
        self._next[index] = min(self._next[index], after) if self._next[index] != float("inf") else after

    def ask(self, unit: str) -> None:
        """Run the unit's check, as the executor does to verify."""
        self._wake(self._of_unit[unit], 0.1)

    # ------------------------------------------------------------ tracker

    def _observe(self, unit: str, result: Result, started: float) -> None:
        if result.level is Level.OK:
            if self.now - self.healthy_from.setdefault(unit, self.now) >= GRACE_ENDS_AFTER_OK_S:
                self.sure[unit] = self.now
        else:
            self.healthy_from.pop(unit, None)
        self.take(self.tracker.observe(unit, result, started, self.stamp()))

    def take(self, step: Effects) -> None:
        for event in step.events:
            self.publish(event)
        self.wake(step.rerun, 0.9)

    def publish(self, event: Event) -> None:
        """Publish one event."""
        self.events.append((self.now, event))
        if isinstance(event, FaultOpened):
            self._opened(event)
        if isinstance(event, Transition) and event.new is Level.OK and event.old is Level.ERROR:
            self.grant(self.tracker.graph.downstream(event.unit))
        for listener in self.listeners:
            listener(event)

    def wake(self, units: Iterable[str], within_s: float) -> None:
        for unit in sorted(units):
            self._wake(self._of_unit[unit], within_s)

    def grant(self, units: Iterable[str]) -> None:
        """From now on these units have grace: earlier observations must not be reported."""
        for unit in units:
            self.granted[unit] = self.now
            self.healthy_from.pop(unit, None)

    def _opened(self, event: FaultOpened) -> None:
        """Assert what holds for every alarm."""
        unit, grace_s = event.fault.unit, self._graces[event.fault.unit]
        since = self.granted[unit]
        assert event.fault.result.level is Level.ERROR
        result, action = event.fault.result, self.tracker.action_on(TARGET)
        detached = result.condition == DETACHED and result.evidence.conclusive and action != RECONNECTS
        held = self.held and self.now < self.held_until and result.condition not in FROM_OUTSIDE
        assert not held or unit not in self.touched or detached, f"{unit} reported during an action"
        assert since == 0.0 or self.tracker.last_started(unit) >= since, f"{unit} reported by old evidence"
        assert self.now - since >= grace_s or self.sure.get(unit, -1.0) >= since, f"{unit} reported within its grace"

    # ------------------------------------------------------------ questions

    @property
    def opened(self) -> list[str]:
        return [event.fault.unit for _, event in self.events if isinstance(event, FaultOpened)]

    @property
    def closed(self) -> list[FaultClosed]:
        return [event for _, event in self.events if isinstance(event, FaultClosed)]

    def units_at(self, level: Level) -> set[str]:
        return {state.unit for state in self.tracker.states() if state.level is level}

    def root(self, unit: str) -> str:
        """The end of the chain of `blocked_by` that starts at `unit`."""
        for _ in range(len(self._of_unit)):
            above = self.tracker.state(unit).blocked_by
            if not above:
                return unit
            unit = above
        raise AssertionError(f"blocked in a circle: {unit}")
