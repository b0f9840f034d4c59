"""The daemon: builds the parts, keeps the beat, and ends in order. `once` is `phm once`; `phm run` is `phm.runtime.service`."""

from __future__ import annotations

import dataclasses
import logging
import os
import threading
import uuid
from collections.abc import Callable
from functools import partial
from typing import Any

from phm.api import Check
from phm.checking import registry
from phm.checking.pipeline import Pipeline
from phm.checking.plan import CheckPlan, build_plan
from phm.checking.scheduler import WATCH_S, CheckRun, CheckScheduler
from phm.commands.control_server import ControlServer
from phm.commands.handler import CommandHandler
from phm.commands.services import CommandServices
from phm.core import threads
from phm.core.bus import Bus
from phm.core.clock import Clock, SystemClock
from phm.core.closing import Closing
from phm.core.model import ActionEvent, Event, Phase, Stamp, UnitState
from phm.core.process_priority import oom_score_adj
from phm.core.scheduling_delay import WINDOW_S
from phm.core.settings import Settings
from phm.core.watchdog import DaemonWatchdog
from phm.facts import CannotTell, SelfFact
from phm.probes.docker_events import DockerEvent
from phm.recovery.actions.join_network import join_networks
from phm.recovery.base import Action, ActionContext
from phm.recovery.containers.cpu_weights import CpuWeights
from phm.recovery.executor import Executor, NotNow
from phm.recovery.holds.hold_registry import HoldRegistry
from phm.recovery.holds.hold_service import HoldInputs, HoldService
from phm.recovery.persistence.persistence_service import PersistenceService
from phm.recovery.persistence.state import PersistedState
from phm.recovery.safety.armed_state import ArmedMonitor
from phm.recovery.safety.flight_critical import critical_containers
from phm.recovery.shop import Shop
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.reporter_manager import Installed
from phm.runtime.shutdown_marker import ShutdownMarker
from phm.runtime.wiring import Components, build_components
from phm.tracker import Tracker

logger = logging.getLogger(__name__)

STALLED_BEAT_S = 3.0
STOOD_STILL_S = 2.5
"""A pause of the heart, beyond the rest that it takes between two beats, that is told. Of one that its guard has ended it is told however short."""
LOOK_S = 1.0
GUARD_LOOKS = 30
"""A guard that is missing is started again after so many looks."""
STOP_S = 5.0
"""For all of `stop`: Docker sends SIGKILL 10 s after SIGTERM unless it was asked to wait longer."""
CALM_S = 0.5
"""Between two beats while nothing waits: no unit settles, no action is at work. What changes that has the heart beat at once."""
STALLED_END_S = 30.0
"""A daemon that has stalled for so long ends itself, since Docker restarts what exits and not what hangs."""
STALLED_CHECKS_S = 15.0
"""The companion check runs every second; no check coming back for this long means that the engine stalls."""


class Daemon:
    """One agent's PHM. `start` returns at once; every part has threads of its own; `stop` ends them in order.

    Order matters twice: reporters subscribe before the first result, and the MAVLink reporter closes
    before the hub does, so that the ground hears the farewell heartbeat.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Clock | None = None,
        guard: DaemonWatchdog | None = None,
        before: Daemon | None = None,
    ) -> None:
        """before: the daemon whose place this one takes in `start`, with its links and what it knows (`phm.runtime.reload`)."""
        self.settings, self._before = settings, before
        if before is not None:
            before._note_subscribers()
        self._guard = guard
        self._last_end = ShutdownMarker(settings.state_dir)
        self._ended_badly = False
        self._stood_still: tuple[float, float, bool] | None = None
        self.clock = clock or SystemClock()
        self.boot_id = uuid.uuid4().hex[:12]
        self.plan: CheckPlan = build_plan(settings, registry.checks())
        self.bus = Bus(self.clock)
        self._started = self.clock.stamp()
        self._beat = self._started.mono
        self._since: Stamp = before._since if before is not None else self._started
        tracker = Tracker(self.plan.tracked, self._started, fault_prefix=f"{self.boot_id[:4]}-")
        self.pipeline = Pipeline(tracker, self.bus, self.clock, self.plan.pass_limit_s)
        self.components: Components = build_components(
            settings,
            self.clock,
            wake=self._wake,
            docker_event=self._docker_event,
            note=lambda text: self.pipeline.note("PHM", text),
            self_look=self._look_at_self,
            hub=before.components.mavlink if before is not None else None,
        )
        self.engine = CheckScheduler(self.plan.scheduled, self.components.world, self.clock, self._observe)
        self.pipeline.attach(self.engine.wake_units, self.beat_soon)
        self.reporters = Installed(self.bus)
        self.executor: Executor | None = None
        self._held = HoldRegistry()
        self.control: ControlServer | None = before.control if before is not None else None
        self.desk: CommandHandler | None = None
        timeout_s = settings.mavlink.autopilot_timeout
        self.armed = ArmedMonitor(self.components.world.links.autopilot, timeout_s, self.clock)
        world = HoldInputs(
            self.armed.now, self.components.world.docker.container, self._acting_on, self.components.event_stream
        )
        self.holds = HoldService(settings, self._held, self.pipeline, self.bus.publish, self.clock, world)
        self.relief = CpuWeights(
            self.components.engine, self.components.world.docker.container, self.pipeline, self.clock
        )
        self.memory = PersistenceService(settings, self.pipeline, self.bus, self.clock, self.armed)
        self._looks = self._stalled = 0
        self._subscribers: tuple[object, ...] = ()
        self.own_problems: list[Callable[[], str]] = before.own_problems if before is not None else [threads.problem]
        """What else is wrong with this process, each asked for a sentence."""
        self._stop, self._soon = threading.Event(), threading.Event()
        self._heart = threading.Thread(target=self._beat_on, name="phm-heart", daemon=True)

    # ------------------------------------------------------------ life

    def start(self) -> None:
        before, self._before = self._before, None
        if before is None:
            self._ended_badly = self._last_end.begin()
        self.memory.restore(before._hand_over() if before is not None else None)
        self.reporters.start(self._reporter_context())
        self._start_recovery()
        self._tell_what_could_not_load()
        self.components.start(links=before is None)
        threads.start(threading.Thread(target=self._join_networks, name="phm-join", daemon=True))
        self.engine.start()
        threads.start(self._heart)

    def look(self) -> bool:
        """To be called every LOOK_S; False when PHM has stalled for STALLED_END_S and must be replaced.

        Looks are counted, not seconds: after a pause of the whole machine the first look is not held against us.
        """
        self._looks += 1
        self._stalled = 0 if self.alive() else self._stalled + 1
        threads.retry()
        if self._guard is not None and self._looks % GUARD_LOOKS == 0:
            self._guard.revive()
        return self._stalled * LOOK_S < STALLED_END_S

    def beat_soon(self) -> None:
        """Have the heart beat now: there is something to wait for, or PHM was stopped and goes on."""
        self._soon.set()

    def stop(self) -> tuple[str, ...]:
        """End every part in order, within STOP_S for all together; the names of those that hang."""
        closing = Closing(self.clock, STOP_S)
        self._stop.set()
        closing.step("marker", self._last_end.end, 0.5)  # an end that was asked for, however it goes on
        if self._guard is not None:
            closing.step("guard", self._guard.close, 0.5)
        self.pipeline.note("PHM", "PHM is stopping")
        for name, part in (("control", self.control), ("commands", self.desk)):
            if part is not None:
                closing.step(name, part.close, 0.5)
        if self.executor is not None:
            self.holds.close()
            self.executor.stop()
        closing.step("relief", self.relief.end, 1.0)
        self.engine.end()
        self.components.engine.close()  # cuts the calls that checks and actions wait for
        closing.step("checks", partial(self.engine.stop, 1.0), 1.5)
        closing.step("events", partial(self.bus.close, 1.0), 1.5)
        for name, close in self.reporters.closers():
            closing.step(name, close, 1.0)
        closing.step("state", self.memory.close, 1.0)
        for name, close in self.components.closers():
            closing.step(name, close, 1.5)
        return tuple(closing.hung)

    def _note_subscribers(self) -> None:
        """What listens to the links now belongs to this daemon, and what comes from now on to the next."""
        if self.components.mavlink is not None:
            self._subscribers = self.components.mavlink.subscribers()

    def acting(self) -> str:
        """The recovery action that is under way, empty when there is none."""
        acts = self.executor.kept().under_way if self.executor is not None else {}
        return ", ".join(f"{act.attempt.action} of {target}" for target, act in acts.items())

    def keep_links(self) -> None:
        """The next daemon could not be made: what it has left at the links goes."""
        if self.components.mavlink is not None:
            mine = self._subscribers
            self.components.mavlink.forget(each for each in self.components.mavlink.subscribers() if each not in mine)

    def _hand_over(self) -> PersistedState:
        """End all but links, control socket and guard, and give away what is known. The heart and the reporters end last,
        so that heartbeats go on until the next daemon sends its own.
        """
        closing = Closing(self.clock, STOP_S)
        if self.desk is not None:
            closing.step("commands", self.desk.close, 0.5)
        if self.executor is not None:
            self.holds.close()
            self.executor.stop()
        self.engine.end()
        self.components.engine.close()
        closing.step("checks", partial(self.engine.stop, 1.0), 1.5)
        for name, close in self.components.closers(links=False):
            closing.step(name, close, 1.5)
        state = self.memory.state()
        self._stop.set()
        self._soon.set()
        closing.step("heart", partial(threads.join, self._heart, 1.0), 1.0)
        closing.step("events", partial(self.bus.close, 1.0), 1.5)
        for name, close in self.reporters.closers(last=False):
            closing.step(name, close, 1.0)
        if self.components.mavlink is not None:
            self.components.mavlink.forget(self._subscribers)
        return state

    def alive(self) -> bool:
        """The dead man's switch of heartbeats and of `phm status --healthy`: beating, and checks come back."""
        return self._quiet_s(self._beat, STALLED_BEAT_S) < STALLED_BEAT_S and (
            self._quiet_s(self.pipeline.last_result_at, STALLED_CHECKS_S) < STALLED_CHECKS_S
        )

    def _quiet_s(self, since: float, limit_s: float) -> float:
        """Seconds since then in which PHM ran: what is starved is late, and has not stalled."""
        age_s = self.clock.mono() - since
        return age_s if age_s < limit_s else age_s - self.clock.late_s(since, limit_s)

    def health(self) -> dict[str, Any]:
        """PHM's own condition for `phm status`; JSON-able."""
        fact, armed = self.components.world.myself.look(), self.armed.now()
        critical = {"containers": critical_containers(self.settings), "armed": armed.state.value, "why": armed.why}
        return {
            "started_utc": self._since.utc,
            "uptime_s": round(fact.uptime_s, 1),
            "overdue": list(fact.overdue),
            "dropped": dict(fact.dropped),
            "problems": list(fact.problems),
            "ros_restarts": fact.ros_restarts,
            "process": {"nice": os.getpriority(os.PRIO_PROCESS, 0), "oom_score_adj": oom_score_adj()},
            "late_percent": round(100 * self.clock.late_s(self.clock.mono() - WINDOW_S) / WINDOW_S, 1),
            **({"flight_critical": critical} if critical["containers"] else {}),
            "ros_sandbox": self.components.ros.sandbox if self.components.ros is not None else None,
            "links": self.components.link_reports(),
            "reporters": self.reporters.reports(),
        }

    # ------------------------------------------------------------ wiring

    def _observe(self, batch: CheckRun) -> None:
        """What the engine reported before these results were there is applied first: it may explain them."""
        if not batch.overdue:  # STALE, and brought by the heart, which waits for nobody
            self.components.catch_up()
        self.pipeline.observe(dict(batch.units), batch.started, batch.duration_s, overdue=batch.overdue)

    def _wake(self, subject: str) -> None:
        self.engine.wake_subject(subject)

    def _docker_event(self, event: DockerEvent) -> None:
        self.pipeline.note("DOCKER", str(event))
        if event.kind == "container" and not event.harmless:
            self.holds.happened(event.key, "start" if event.begins_life else event.action, event.detail, event.id)
        if event.end_s:
            self.pipeline.expect_stop(event.key, event.end_s)
        if event.ends_life:
            self.pipeline.container_ended(event.key)
        if event.begins_life:
            self.pipeline.container_started(event.key)
            self.components.begun(event.key)
        for subject in event.subjects:
            self._wake(subject)

    def _look_at_self(self) -> SelfFact:
        problems = self.reporters.problems()
        parts = (self.memory, self.control, self.components.mavlink)
        problems += [part.problem() for part in parts if part is not None and part.problem()]
        if self._guard is not None and self._guard.problem:
            problems.append(self._guard.problem)
        problems += [problem for ask in self.own_problems if (problem := ask())]
        now = self.clock.mono()
        still = self._stood_still
        return SelfFact(
            now - self._since.mono,
            self.engine.overdue(),
            self.bus.dropped(),
            (*problems, *self.bus.problems()),
            ended_badly=self._ended_badly,
            stood_still_s=still[1] if still else None,
            stood_still_ago_s=now - still[0] if still else None,
            was_stopped=still is not None and still[2],
        )

    def _reporter_context(self) -> ReporterContext:
        return ReporterContext(
            self.settings,
            self.clock,
            self.boot_id,
            self.pipeline.states,
            self.alive,
            self.health,
            self.components.mavlink,
            restored=self.pipeline.open_faults(),
            ros=self.components.ros,
            swarm=self.components.world.swarm,
            pilot=self._pilot_heard,
            radio=self._radio_heard,
            open_faults=self.pipeline.open_faults,
            given_up=self.pipeline.given_up,
            holds=self.holds.snapshot,
        )

    def _start_recovery(self) -> None:
        actions = registry.usable(registry.find(registry.ACTIONS, Action))
        graces = {entry.unit.id: entry.unit.grace_s for entry in self.plan.tracked}
        shop = Shop(
            self.pipeline,
            self._publish_action,
            self.clock,
            actions,
            self._action_context(),
            self.armed.now,
            lambda unit: graces.get(unit, 0.0),
            self.plan.below,
            self._held,
        )
        self.executor = Executor(shop)
        self.memory.resume(self.executor)
        self.bus.subscribe("recovery", self.executor.handle, kinds=Executor.kinds, key=Executor.key)
        relief = self.relief
        if self.settings.recovery.relieve or relief.kept():
            self.bus.subscribe("relief", relief.handle, kinds=relief.kinds, tick=relief.tick, period_s=relief.period_s)
        self.holds.start()
        if self.control is None:
            self.control = ControlServer(self.settings.run_dir, self.executor.approve, self.pipeline.note, self.holds)
            self.control.start()
        else:
            self.control.serve(self.executor.approve, self.pipeline.note, self.holds)
        self._start_desk(self.executor)

    def _start_desk(self, executor: Executor) -> None:
        """What the ground may ask for by MAVLink."""
        if self.components.mavlink is None:
            return
        pipeline = self.pipeline
        services = CommandServices(
            pipeline.states,
            pipeline.open_faults,
            pipeline.recent_faults,
            lambda: pipeline.complete,
            self.alive,
            look=lambda: pipeline.recheck(*(state.unit for state in pipeline.states())),
            approve=executor.approve,
            restart=executor.restart,
            note=pipeline.note,
            later=NotNow,
            remember=self.components.mavlink.remember,
            clock_problem=self.components.mavlink.clock_problem,
        )
        self.desk = CommandHandler(self.components.mavlink, services, self.settings, self.clock)
        self.desk.start()

    def _action_context(self) -> ActionContext:
        autopilot = self.components.world.links.autopilot
        return dataclasses.replace(
            self._docker_context(), link=self.components.link, autopilot=autopilot, clock=self.clock
        )

    def _docker_context(self) -> ActionContext:
        docker = self.components.world.docker
        return ActionContext(
            self.components.engine,
            self.settings,
            docker.container,
            docker.myself,
            self.components.remembered,
            listed_nodes=lambda: self.components.world.ros.look().nodes,
            reopen=self.components.reopen,
            on_hold=self._hold_words,
            relief=self.relief,
        )

    def _publish_action(self, event: Event) -> None:
        self.bus.publish(event)
        if isinstance(event, ActionEvent) and event.phase is Phase.DONE and event.action == "join_network":
            self.components.renew_ros("PHM joined a network")

    def _acting_on(self, container: str) -> bool:
        return self.executor is not None and self.executor.action_on(container)

    def _hold_words(self, container: str) -> str:
        return self._held.why_not_start(container, self.clock.stamp())

    def _radio_heard(self) -> bool:
        """As the radio's check, a radio counts as silent after two and a half of its own pauses."""
        least_s = self.settings.mavlink.radio_timeout
        return any(radio.silent_s <= max(least_s, 2.5 * radio.due_s) for radio in self.components.world.links.radios())

    def _pilot_heard(self) -> bool:
        pilot = self.components.world.links.autopilot()
        return pilot is not None and pilot.silent_s <= self.settings.mavlink.autopilot_timeout

    def _join_networks(self) -> None:
        """Before ROS starts: DDS picks its interfaces when the participant is made. Nobody waits for this.

        Done in every recovery mode: it is how PHM comes to see, and it touches PHM's own container alone.
        """
        for container in self.settings.containers:
            try:
                done = join_networks(container, self._action_context())
            except CannotTell as error:
                self.pipeline.note("PHM", f"could not join the networks of {container.key}: {error}")
            except Exception as error:  # an unexpected answer must not keep ROS from starting
                logger.exception("the networks of %s could not be joined", container.key)
                words = f"could not join the networks of {container.key}: {type(error).__name__}: {error}"
                self.pipeline.note("PHM", words)
            else:
                if done:
                    self.pipeline.note("ACTION", done)
        self.components.start_ros()

    def _tell_what_could_not_load(self) -> None:
        groups: tuple[tuple[str, type], ...] = (
            (registry.CHECKS, Check),
            (registry.REPORTERS, Reporter),
            (registry.ACTIONS, Action),
        )
        for group, base in groups:
            for found in registry.find(group, base):
                if found.loaded is None:
                    self.pipeline.note("PHM", f"{group} {found.name} from {found.source} is not used: {found.problem}")

    # ------------------------------------------------------------ the beat

    def _beat_on(self) -> None:
        next_pass = self._beat = self.clock.mono()  # how long the start took is no pause
        wait_s = 0.0
        while not self._stop.is_set():
            calm_s = WATCH_S
            try:
                now = self.clock.mono()
                was_stopped = self._guard is not None and self._guard.beat()
                paused_s, self._beat = now - self._beat, now
                if was_stopped or paused_s - wait_s > STOOD_STILL_S:
                    self._stood_still = (now, paused_s, was_stopped)
                    self._wake("myself")
                if now >= next_pass:
                    self.pipeline.begin_pass()
                    next_pass = max(next_pass + self.settings.interval, now)
                calm_s = min(CALM_S, self.engine.look_for_overdue(), next_pass - now)
                if self.components.caught_up():
                    self.pipeline.tick()
            except Exception:  # a defect that shows in one beat must not end all: passes and deadlines hang on it
                logger.exception("the heart missed a beat")
            wait_s = WATCH_S if self.pipeline.waiting else max(WATCH_S, calm_s)
            self.clock.wait(self._soon, wait_s)
            self._soon.clear()


def once(settings: Settings, clock: Clock | None = None) -> tuple[UnitState, ...]:
    """One pass that changes nothing in the world: no recovery, no reports, no network joined, no endpoint opened.

    Waits until every unit is decided (ROS discovery needs its grace), at most the longest grace and
    deadline together.
    """
    clock = clock or SystemClock()
    silent = settings.model_copy(update={"mavlink": settings.mavlink.model_copy(update={"endpoints": []})})
    daemon = Daemon(silent, clock)
    longest_grace_s = max((entry.unit.grace_s + entry.unit.settle_s for entry in daemon.plan.tracked), default=0.0)
    end = clock.mono() + longest_grace_s + daemon.plan.pass_limit_s
    try:
        daemon.components.start_ros()
        daemon.engine.start()
        tick = threading.Event()
        while clock.mono() < end:
            threads.retry()
            daemon.engine.look_for_overdue()
            daemon.pipeline.tick()
            if not daemon.pipeline.undecided():
                break
            clock.wait(tick, 0.05)
        return daemon.pipeline.states()
    finally:
        daemon.engine.stop(0.5)
        daemon.components.close()
