"""The parts of one daemon, built in the order of the data flow: probes, scheduler, tracker, recovery, health, reporters, operator
commands.

Building opens nothing and starts no thread; `phm.runtime.daemon` starts and stops what is built here. What flows back (a probe
that wakes a check, an action that restarts ROS) is passed as a function, since its receiver is built later.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from phm.checking import registry
from phm.checking.check_turns import CheckRun
from phm.checking.pipeline import Pipeline
from phm.checking.plan import CheckPlan, build_plan
from phm.checking.scheduler import CheckScheduler
from phm.commands.control_server import ControlServer
from phm.commands.handler import CommandHandler
from phm.commands.mavlink_commands import MavlinkCommands
from phm.commands.services import CommandServices, no_reload
from phm.core.bus import Bus
from phm.core.clock import Clock
from phm.core.settings import Settings
from phm.core.watchdog import DaemonWatchdog
from phm.facts import SelfFact
from phm.probes import cgroups
from phm.probes.docker_event import DockerEvent
from phm.probes.docker_facts import container_fact
from phm.recovery.actions.cpu_weights import CpuWeights
from phm.recovery.base import Action, ActionContext
from phm.recovery.executor import Executor, NotNow
from phm.recovery.holds.hold_registry import HoldRegistry
from phm.recovery.holds.hold_service import HoldInputs, HoldService
from phm.recovery.persistence.persistence_service import PersistenceService
from phm.recovery.safety.armed_state import ArmedMonitor, ArmedState
from phm.recovery.safety.flight_critical import critical_containers
from phm.reporters.base import ReporterContext
from phm.reporters.reporter_manager import ReporterManager
from phm.runtime.docker_events import DockerEventRouter
from phm.runtime.health import DaemonHealth
from phm.runtime.main_loop import MainLoop
from phm.runtime.network_join import join_all_networks
from phm.runtime.probe_set import ProbeSet, build_probes
from phm.runtime.sections import action_settings, reporter_settings
from phm.tracker import Tracker
from phm.wire.status_file import place


@dataclass(frozen=True, slots=True)
class ProcessParts:
    """The parts of the process, which outlive a daemon when the configuration is reloaded.

    watchdog: the watchdog process, if one is used.
    problems: what else may be wrong with this process; each gives a sentence or an empty text.
    reload:   reloads the configuration for `phm reload`; the outcome as JSON.
    """

    clock: Clock
    watchdog: DaemonWatchdog | None = None
    problems: Sequence[Callable[[], str]] = ()
    reload: Callable[[], str] = no_reload


class Components:
    """Everything that one daemon consists of.

    plan:     the checks and their dependency graph, if they are built already (`phm.runtime.configuration`).
    previous: of the daemon that this one replaces (`phm.runtime.reloader`): its links and its control socket stay open.
    """

    def __init__(
        self,
        settings: Settings,
        process: ProcessParts,
        *,
        plan: CheckPlan | None = None,
        previous: Components | None = None,
    ) -> None:
        self.settings, self.process = settings, process
        clock, watchdog = process.clock, process.watchdog
        self.clock, self.boot_id = clock, uuid.uuid4().hex[:12]
        started = clock.stamp()
        self.plan = plan or build_plan(settings, registry.checks())
        self.bus = Bus(clock)
        tracker = Tracker(self.plan.tracked, self.plan.graph, started, fault_prefix=f"{self.boot_id[:4]}-")
        self.pipeline = Pipeline(tracker, self.bus, clock, self.plan.pass_limit_s)
        self.probes: ProbeSet = build_probes(
            settings,
            clock,
            wake=self._wake,
            docker_event=self._docker_event,
            note=lambda text: self.pipeline.note("PHM", text),
            read_self=self._self_fact,
            hub=previous.probes.mavlink if previous is not None else None,
        )
        self.scheduler = CheckScheduler(self.plan.scheduled, self.probes.world, clock, self._observe)
        self.loop = MainLoop(
            settings.interval,
            clock,
            self.scheduler,
            self.pipeline,
            self.probes.caught_up,
            lambda: self._wake("daemon"),
            watchdog,
        )
        self.pipeline.attach(self.scheduler.wake_units, self.loop.wake)
        self._build_recovery(settings)
        self.docker_events = DockerEventRouter(self.pipeline, self.scheduler, self.holds, self.probes.container_started)
        self.control: ControlServer = previous.control if previous is not None else ControlServer(settings.run_dir)
        self.reporters = ReporterManager(self.bus)
        own = (
            self.persistence.problem,
            self.control.problem,
            *((self.probes.mavlink.problem,) if self.probes.mavlink else ()),
        )
        guard = (lambda: watchdog.problem,) if watchdog is not None else ()
        self.health: DaemonHealth = DaemonHealth(
            since=previous.health.since if previous is not None else started,
            clock=clock,
            loop=self.loop,
            scheduler=self.scheduler,
            pipeline=self.pipeline,
            bus=self.bus,
            probes=self.probes,
            reporters=self.reporters,
            armed=self.armed,
            critical=critical_containers(settings.containers),
            problems=(*own, *guard, *process.problems),
        )
        self.reporter_context = self._reporter_context(settings)
        self._build_commands(settings, process.reload)

    # ------------------------------------------------------------ recovery

    def _build_recovery(self, settings: Settings) -> None:
        pipeline, clock, docker = self.pipeline, self.clock, self.probes.world.docker
        self.armed = ArmedMonitor(self.probes.world.links.autopilot, settings.mavlink.autopilot_timeout, clock)
        held = HoldRegistry()
        inputs = HoldInputs(
            armed=self.armed.now,
            container=docker.container,
            own=self._acting_on,
            stream=self.probes.event_stream,
            inspect=self.probes.engine.inspect,
        )
        self.holds = HoldService(
            settings.recovery, settings.containers, held, pipeline, self.bus.publish, clock, inputs
        )
        cgroup_root = Path(settings.pressure.cgroups)
        self.relief = CpuWeights(
            self.probes.engine,
            lambda ref: container_fact(self.probes.engine.inspect(ref)),
            pipeline,
            clock,
            lambda fact: cgroups.cpu_weight(cgroup_root, fact),
        )
        self.may_relieve = bool(settings.recovery.relieve)
        self.persistence = PersistenceService(
            settings.state_dir, settings.recovery.window, pipeline, self.bus, clock, self.armed
        )
        self.action_context = ActionContext(
            engine=self.probes.engine,
            settings=action_settings(settings),
            container=docker.container,
            own_container=docker.own_container,
            last_attachment=self.probes.docker.remembered,
            own_attachment=self.probes.docker.own_remembered,
            reachable=docker.reachable,
            listed_nodes=lambda: self.probes.world.ros.snapshot().nodes,
            link=self.probes.link,
            autopilot=self.probes.world.links.autopilot,
            clock=clock,
            reopen=self.probes.reopen,
            on_hold=lambda key: (
                held.why_not_start(key, clock.stamp()) or ("being stopped" if pipeline.is_stopping(key) else "")
            ),
            relief=self.relief,
            restart_ros=self.probes.restart_ros,
        )
        graces = {entry.unit.id: entry.unit.grace_s for entry in self.plan.tracked}
        self.executor = Executor(
            pipeline,
            self.bus.publish,
            clock,
            actions=registry.usable(registry.find(registry.ACTIONS, Action)),
            context=self.action_context,
            armed=self.armed.now,
            grace_s=lambda unit: graces.get(unit, 0.0),
            below=self.plan.below,
            holds=held,
        )

    def join_networks(self, start_ros: Callable[[], None]) -> None:
        """Join the networks of the configured containers, then start ROS. If the engine does not answer, ROS does not wait for it, and is
        started again after a later join. Never raises."""
        left = join_all_networks(self.settings.containers, self.action_context, self.pipeline.note, ros_runs=False)
        start_ros()
        for _ in self.settings.containers:  # as often as each would be asked once
            if left:
                left = join_all_networks(left, self.action_context, self.pipeline.note, ros_runs=True)

    # ------------------------------------------------------------ what flows back

    def _wake(self, subject: str) -> None:
        """During a reload the links stay open, so a probe may call this before the scheduler is built; its start runs all checks."""
        scheduler: CheckScheduler | None = getattr(self, "scheduler", None)
        if scheduler is not None:
            scheduler.wake_subject(subject)

    def _docker_event(self, event: DockerEvent) -> None:
        self.docker_events.apply(event)

    def _self_fact(self) -> SelfFact:
        return self.health.fact()

    def _acting_on(self, container: str) -> bool:
        return self.executor.action_on(container)

    def _observe(self, batch: CheckRun) -> None:
        """Docker events that arrived before these results are applied first, because they may explain them."""
        if not batch.overdue:  # an overdue check's STALE comes from the main loop, which must not wait
            self.probes.catch_up()
        self.pipeline.observe(dict(batch.units), batch.started, batch.duration_s, overdue=batch.overdue)

    # ------------------------------------------------------------ reporters

    def _reporter_context(self, settings: Settings) -> ReporterContext:
        links, pipeline, mavlink = self.probes.world.links, self.pipeline, settings.mavlink

        def autopilot_received() -> bool:
            autopilot = links.autopilot()
            return autopilot is not None and autopilot.silent_s <= mavlink.autopilot_timeout

        def radio_received() -> bool:  # by the same rule as the radio check: 2.5 of the radio's own periods
            return any(radio.silent_s <= max(mavlink.radio_timeout, 2.5 * radio.due_s) for radio in links.radios())

        return ReporterContext(
            reporter_settings(settings),
            self.clock,
            self.boot_id,
            pipeline.states,
            self.health.alive,
            self.health.document,
            self.probes.mavlink,
            ros=self.probes.ros,
            swarm=self.probes.world.swarm,
            autopilot=autopilot_received,
            armed=self._known_armed,
            reported_armed=self.armed.reported,
            radio=radio_received,
            open_faults=pipeline.open_faults,
            given_up=pipeline.given_up,
            newest=pipeline.newest,
            links=links,
            queues=self.bus.queues,
            machine_boot=place()["machine_boot"],
            holds=self.holds.snapshot,
        )

    def _known_armed(self) -> bool | None:
        """Whether the autopilot is armed; None: unknown."""
        return {ArmedState.ARMED: True, ArmedState.DISARMED: False}.get(self.armed.now().state)

    # ------------------------------------------------------------ operator commands

    def _build_commands(self, settings: Settings, reload: Callable[[], str]) -> None:
        """MAVLink and the control socket lead to one handler."""
        hub, pipeline = self.probes.mavlink, self.pipeline
        services = CommandServices(
            pipeline.states,
            pipeline.open_faults,
            pipeline.recent_faults,
            lambda: pipeline.complete,
            self.health.alive,
            run_checks=lambda: pipeline.recheck(*(state.unit for state in pipeline.states())),
            approve=self.executor.approve,
            restart=self.executor.restart,
            note=pipeline.note,
            later=NotNow,
            holds=self.holds,
            reload=reload,
        )
        if hub is not None:
            services = replace(services, remember=hub.remember, clock_problem=hub.clock_problem)
        self.handler = CommandHandler(services, [entry.key for entry in settings.containers], self.clock)
        self.mavlink_commands: MavlinkCommands | None = None
        if hub is not None:
            self.mavlink_commands = MavlinkCommands(
                hub, self.handler, services, settings.mavlink, settings.agent.id, self.clock
            )
