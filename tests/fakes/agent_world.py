"""A simulated agent for the tracker: what each unit would report, when, and who repairs it.

Truth changes at one moment; its evidence reaches the units later or, for dependents, even earlier than the
cause's own. The bounds below are the promises that the tracker's guarantee rests on; everything else (which check
runs when, how long a run takes, which wake-ups are lost) is random.

- A cause is seen by any run of its own check that looks at or after the moment of the fault. Its event may be lost.
- Nodes are judged dead from 0.05 s (they say goodbye up to 0.25 s before, and their check waits for 0.3 s) to 2 s after
  the fault (the lease of `config/fastdds.xml` ends).
- The endpoints of a topic disappear from 1 s before to 1 s after their node; `settle_s` of topics is 1.5 s.
- A topic is silent 0.5 s after the fault at the earliest; `settle_s` of rates is 2 s, so it is never told before its node
  is seen missing.
- After a repair nodes are back within 5 s, topics 1 s and rates 3 s later: each within its grace of 8 s. A killed node
  may stay listed for another second after its container has started again (a ghost).
- A run takes 0.2 s at most, a wake-up that is not lost is served within 0.9 s.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from random import Random

from phm import plan, registry
from phm.config import load
from phm.model import Event, Fault, FaultClosed, FaultOpened, Level, Result, Stamp, Transition
from phm.plan import Plan
from phm.recovery.history import Attempt, History
from phm.recovery.policy import Act, decide
from phm.settings import Settings
from phm.tracker import SURE_S, Step, Tracker

ROOT = Path(__file__).resolve().parents[2]
TARGET = "ros_app"
TICK_S = 0.1
SILENCE_S = 0.5
OK = Result(Level.OK, "well")
NODES = {n: f"nodes/agent_1/node_{n}" for n in (1, 2, 3)}
TOPICS = {n: f"topics/agent_1/topic_{n}" for n in (1, 2, 3)}
RATES = {n: f"rates/agent_1/topic_{n}" for n in (1, 2, 3)}
CAUSES = {
    "container": ("container/ros_app", "exited"),
    "paused": ("container/ros_app", "paused"),
    "unhealthy": ("health/ros_app", "unhealthy"),
    "network": ("network/ros_app", "disconnected"),
    "file": ("files/ros_app", "missing"),
    "device": ("devices/ros_app", "missing"),
    "disk": ("host/disk", "disk_full"),
    **{f"node_{n}": (NODES[n], "node_missing") for n in NODES},
    **{f"silent_{n}": (RATES[n], "silent") for n in RATES},
}
"""Primary faults: the unit that is the cause, and its condition."""
FIXES = {
    "start": {"container"},
    "unpause": {"paused"},
    "reconnect": {"network"},
    "restore": {"file"},
    "relaunch": {"node_1", "node_2", "node_3", "silent_1", "silent_2", "silent_3"},
    "restart": set(CAUSES) - {"file", "device", "disk"},
}


@cache
def shipped() -> tuple[Settings, Plan]:
    """The shipped configuration and its plan, made from the installed checks."""
    settings = load(str(ROOT / "config" / "phm.yaml"), environ={})
    return settings, plan.make(settings, registry.checks())


@dataclass(slots=True)
class Bad:
    """A span in which `unit` is seen as bad; `back_s` after the repair it is well."""

    unit: str
    begin: float
    condition: str
    back_s: float
    end: float = float("inf")


@dataclass(slots=True)
class World:
    """What is true when. `down` lists the spans in which the container does not run."""

    random: Random
    bad: dict[str, list[Bad]] = field(default_factory=dict)
    active: dict[str, list[Bad]] = field(default_factory=dict)
    ghosts: list[tuple[float, float]] = field(default_factory=list)

    def inject(self, kind: str, at: float) -> None:
        """Make a primary fault true at `at`, with all its consequences."""
        unit, condition = CAUSES[kind]
        rnd, spans = self.random, []
        family, _, number = kind.partition("_")
        first = at + rnd.uniform(SILENCE_S, SILENCE_S + 0.5) if family == "silent" else at
        spans.append(Bad(unit, first, condition, rnd.uniform(0.3, 5.0) if family == "node" else 0.0))
        if family in ("container", "paused", "network", "node"):
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
                # The needs of a topic are all its nodes: evidence may precede the first of them, not its cause's settling.
                begin = min(gone[m] for m in ends) + rnd.uniform(-1.0, 1.0)
                topic_back = max(back[m] for m in ends) + rnd.uniform(0.0, 1.0)
                yield Bad(TOPICS[n], begin, "publisher_missing", topic_back)
                if n in nodes:
                    silent = max(at, min(gone.values())) + rnd.uniform(SILENCE_S, SILENCE_S + 1.0)
                    yield Bad(RATES[n], silent, "silent", topic_back + rnd.uniform(0.0, 3.0))

    def repair(self, kind: str, at: float) -> None:
        """The primary fault is no more; its consequences go one after the other."""
        for span in self.active.pop(kind, ()):
            span.end = max(span.begin, at + span.back_s)
        if kind in ("container", "paused"):
            self.ghosts.append((at, at + self.random.uniform(0.0, 1.0)))

    def restart(self, at: float) -> float:
        """An action stops the container and starts it; when it runs again."""
        up = at + self.random.uniform(0.2, 1.0)
        self.inject("container", at)
        self.repair("container", up)
        return up

    def result(self, unit: str, at: float) -> Result:
        """What a run of the unit's check finds at `at`."""
        if unit in ("network/ros_app", "health/ros_app") and self._is_bad("container/ros_app", at):
            return Result(Level.STALE, "not judged while the container does not run")
        if unit.startswith(("nodes/", "topics/")) and any(begin <= at < end for begin, end in self.ghosts):
            return OK
        for span in self.bad.get(unit, ()):
            if span.begin <= at < span.end:
                return Result(Level.ERROR, f"{unit} {span.condition}", span.condition, span.condition, TARGET)
        return OK

    def _is_bad(self, unit: str, at: float) -> bool:
        return any(span.begin <= at < span.end for span in self.bad.get(unit, ()))

    def changes(self, unit: str) -> Iterable[float]:
        for span in self.bad.get(unit, ()):
            yield from (span.begin, span.end)


class Sim:
    """Engine, tracker and clock in one thread. `events` is what the bus would carry."""

    def __init__(self, seed: int, *, warm: bool = True, wakes_lost: float = 0.3) -> None:
        self.settings, self.plan = shipped()
        self.random = Random(seed)
        self.world = World(self.random)
        self.now = 0.0
        self.tracker = Tracker(self.plan.tracked, self.stamp())
        self.events: list[tuple[float, Event]] = []
        self.listeners: list[Callable[[Event], None]] = []
        self.watch: list[Callable[[], None]] = []
        self.wakes_lost = wakes_lost
        self.held: str = ""
        self.granted: dict[str, float] = {entry.unit.id: 0.0 for entry in self.plan.tracked}
        self.well_from: dict[str, float] = {}
        self.sure: dict[str, float] = {}
        own = {entry.unit.id for entry in self.plan.tracked if entry.unit.target == TARGET}
        self.touched = own.union(*(self.tracker.needs.downstream(unit) for unit in own))
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
        """Everything has been well for long enough that grace is over."""
        for _ in range(2):
            for unit in self._of_unit:
                self._observe(unit, OK, self.now)
            self.now += SURE_S + 0.1
        self._next = [self.now + self.random.uniform(0, period) for period in self._periods]
        for unit in self._of_unit:
            self._observe(unit, OK, self.now)

    # ------------------------------------------------------------ time

    def run(self, seconds: float) -> None:
        """Let time pass; every result and every tick in its place."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            tick = self.now + TICK_S
            self._wake_on_changes(self.now, tick)
            while True:
                index = min(range(len(self._next)), key=self._next.__getitem__)
                begins = self._next[index]
                delivered = self._deliveries[0][0] if self._deliveries else tick
                if min(begins, delivered) >= tick:
                    break
                if begins < delivered:
                    self._begin(index, begins)
                else:
                    self._deliver()
            self.now = tick
            self.take(self.tracker.tick(self.stamp()))
            for look in self.watch:
                look()

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
        for index, units in enumerate(self._checks):
            changed = any(begin <= change < end for unit in units for change in self.world.changes(unit))
            if changed and self.random.random() >= self.wakes_lost:
                self._wake(index, 0.1)

    def _wake(self, index: int, within_s: float) -> None:
        after = self.now + self.random.uniform(0.0, within_s)
        if self._busy[index]:
            after += 0.2
        self._next[index] = min(self._next[index], after) if self._next[index] != float("inf") else after

    def ask(self, unit: str) -> None:
        """Have the unit's check run, as the executor does to verify."""
        self._wake(self._of_unit[unit], 0.1)

    # ------------------------------------------------------------ tracker

    def _observe(self, unit: str, result: Result, started: float) -> None:
        if result.level is Level.OK:
            if self.now - self.well_from.setdefault(unit, self.now) >= SURE_S:
                self.sure[unit] = self.now
        else:
            self.well_from.pop(unit, None)
        self.take(self.tracker.observe(unit, result, started, self.stamp()))

    def take(self, step: Step) -> None:
        for event in step.events:
            self.events.append((self.now, event))
            if isinstance(event, FaultOpened):
                self._opened(event)
            if isinstance(event, Transition) and event.new is Level.OK and event.old is Level.ERROR:
                self.grant(self.tracker.needs.downstream(event.unit))
            for listener in self.listeners:
                listener(event)
        for unit in sorted(step.rerun):
            self._wake(self._of_unit[unit], 0.9)

    def grant(self, units: Iterable[str]) -> None:
        """From now on these units have grace: what was seen of them before must not be told."""
        for unit in units:
            self.granted[unit] = self.now
            self.well_from.pop(unit, None)

    def _opened(self, event: FaultOpened) -> None:
        """What must hold for every alarm, whoever asks."""
        unit, grace_s = event.fault.unit, self._graces[event.fault.unit]
        since = self.granted[unit]
        assert event.fault.result.level is Level.ERROR
        assert not self.held or unit not in self.touched, f"{unit} told while an action is at work"
        assert since == 0.0 or self.tracker.last_started(unit) >= since, f"{unit} told by old evidence"
        assert self.now - since >= grace_s or self.sure.get(unit, -1.0) >= since, f"{unit} told within its grace"

    # ------------------------------------------------------------ questions

    @property
    def opened(self) -> list[str]:
        return [event.fault.unit for _, event in self.events if isinstance(event, FaultOpened)]

    @property
    def closed(self) -> list[FaultClosed]:
        return [event for _, event in self.events if isinstance(event, FaultClosed)]

    def told(self, level: Level) -> set[str]:
        return {state.unit for state in self.tracker.states() if state.level is level}

    def root(self, unit: str) -> str:
        """The end of the chain of `blocked_by` that begins at `unit`."""
        for _ in range(len(self._of_unit)):
            above = self.tracker.state(unit).blocked_by
            if not above:
                return unit
            unit = above
        raise AssertionError(f"blocked in a circle: {unit}")


class Healer:
    """A virtual executor for the one container: the real policy decides, the world obeys or does not.

    `acted` holds (begin, end, action, fault) of each action; `ends` is when the action at work is over.
    """

    def __init__(self, sim: Sim, *, helps: float = 1.0, armed: Callable[[float], bool] = lambda now: False) -> None:
        self.sim, self.helps, self.armed = sim, helps, armed
        self.recovery = sim.settings.recovery
        self.container = sim.settings.container(TARGET)
        self.history = History()
        self.cases: dict[str, Fault] = {}
        self.acted: list[tuple[float, float, str, Fault]] = []
        self._at_work: tuple[Fault, str, float, float, int] | None = None
        sim.listeners.append(self.hear)
        sim.watch.append(self.look)

    def hear(self, event: Event) -> None:
        if isinstance(event, FaultOpened) and event.fault.result.target == TARGET:
            self.cases[event.fault.unit] = event.fault
        elif isinstance(event, FaultClosed):
            self.cases.pop(event.fault.unit, None)

    def look(self) -> None:
        if self._at_work is not None:
            self._verify(*self._at_work)
            return
        for fault in sorted(self.cases.values(), key=lambda fault: fault.slot):
            decision = decide(
                fault,
                self.history,
                self.sim.now,
                container=self.container,
                armed=self.armed(self.sim.now),
                settings=self.recovery,
            )
            if isinstance(decision, Act):
                self._begin(fault, decision.action)
                return

    def _begin(self, fault: Fault, action: str) -> None:
        sim = self.sim
        assert not sim.held, "two actions at once"
        sim.held = fault.unit
        sim.take(sim.tracker.hold(TARGET, fault.unit, action, sim.stamp(), 60.0))
        acts = sim.now + sim.random.uniform(0.1, 1.0)
        done = sim.world.restart(acts) if action == "restart" else acts
        helped = sim.random.random() < self.helps
        for kind in list(sim.world.active):
            if kind in FIXES[action] and helped:
                sim.world.repair(kind, done)
        verify_s = self.recovery.verify if helped else 3.0
        self._at_work = (fault, action, sim.now, done, int(verify_s))

    def _verify(self, fault: Fault, action: str, began: float, done: float, verify_s: int) -> None:
        sim = self.sim
        state = sim.tracker.state(fault.unit)
        worked = state.level is Level.OK and sim.tracker.last_started(fault.unit) >= done
        if not worked and sim.now - done < verify_s:
            if sim.now > done and sim.random.random() < 0.2:
                sim.ask(fault.unit)
            return
        self._at_work, sim.held = None, ""
        self.acted.append((began, sim.now, action, fault))
        self.history.add(Attempt(began, fault.unit, fault.result.condition, action, worked))
        sim.grant(sim.touched)
        sim.take(sim.tracker.release(TARGET, sim.stamp(), worked=worked))
