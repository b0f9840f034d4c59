"""Builds everything that reads from the outside: Docker client, probes, MAVLink endpoints and the ROS child process.

This is the only module that knows which class implements which protocol of `phm.facts`. Building opens nothing; `start` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import Settings
from phm.facts import COMPLETE, CannotTell, EventStreamFact, LinkFact, RosFact, RosProbe, SelfFact, World
from phm.probes.attachment_cache import AttachmentCache
from phm.probes.container_watcher import ContainerWatcher
from phm.probes.devices import Devices
from phm.probes.docker import Docker
from phm.probes.docker_event import DockerEvent
from phm.probes.files import Files
from phm.probes.host import Host, clock_synchronized
from phm.probes.inotify import FileWatcher
from phm.probes.links import Links
from phm.probes.logs import Logs
from phm.probes.mavlink_messages import MavlinkMessages
from phm.probes.pattern_matcher import PatternMatcher
from phm.probes.pressure import Pressure
from phm.probes.programs import Programs
from phm.probes.reachability_monitor import ReachabilityMonitor
from phm.probes.ros.environment import RosEnvironments
from phm.probes.ros.supervisor import RosSupervisor
from phm.probes.ros.wanted import uses_ros
from phm.probes.serial_ports import SerialPorts
from phm.probes.sockets import Sockets
from phm.probes.swarm import SwarmMonitor
from phm.transport.docker import DockerEngine
from phm.transport.mavlink import MavlinkHub

ReadSelf = Callable[[], SelfFact]
"""Reads the daemon's own condition."""


class RosNotConfigured:
    """Used when no node and no topic is configured: no child process is needed."""

    def snapshot(self) -> RosFact:
        raise CannotTell("no ROS node or topic is configured")


@dataclass(frozen=True)
class DaemonSelfProbe:
    """Probe of PHM itself: the daemon's condition and that of its ROS child process."""

    read_self: ReadSelf
    ros: RosSupervisor | None
    links: Links

    def snapshot(self) -> SelfFact:
        fact = self.read_self()
        if self.ros is not None:
            fact = replace(fact, problems=(*fact.problems, *self.ros.problems()), ros_restarts=self.ros.restarts)
        return replace(fact, problems=(*fact.problems, *self.links.problems()))


@dataclass(frozen=True)
class ProbeSet:
    """The probes with their connections; `world` is what checks see of them."""

    engine: DockerEngine
    docker: AttachmentCache
    watch: ContainerWatcher | None
    reachability: ReachabilityMonitor | None
    file_watcher: FileWatcher
    mavlink: MavlinkHub | None
    ros: RosSupervisor | None
    sockets: Sockets
    serial: SerialPorts
    matcher: PatternMatcher
    programs: Programs
    logs: Logs
    devices: Devices
    host: Host
    received: Links
    agents: SwarmMonitor
    world: World

    def start(self, *, links: bool = True) -> None:
        """Open the links (unless they are open already) and the event stream. ROS starts later, see `start_ros`."""
        if links and self.mavlink is not None:
            self.mavlink.start()
        if self.watch is not None:
            self.watch.start()
        if self.reachability is not None:
            self.reachability.start()

    def resume_links(self, before: ProbeSet) -> None:
        """Go on with what was received on the links, which stay open."""
        self.received.resume(before.received)
        self.agents.resume(before.agents)

    def event_stream(self) -> EventStreamFact:
        """State of Docker's event stream; complete when no container is configured."""
        return self.watch.fact if self.watch is not None else COMPLETE

    def start_ros(self) -> None:
        """To be called after PHM has joined its networks: DDS chooses its interfaces when a participant is created."""
        if self.ros is not None:
            self.ros.start()

    def restart_ros(self, reason: str) -> None:
        """Replace the ROS child process: a DDS participant keeps the interfaces that it found when it was created."""
        if self.ros is not None:
            self.ros.renew(reason)

    def link(self, name: str) -> LinkFact | None:
        """The MAVLink endpoint of this name, with its traffic."""
        return next((link for link in self.world.links.links() if link.name == name), None)

    def reopen(self, link: str, timeout_s: float) -> bool:
        """See `MavlinkHub.reopen`."""
        return self.mavlink is not None and self.mavlink.reopen(link, timeout_s)

    def container_started(self, container: str) -> None:
        """Retry the links to this container immediately: see `MavlinkHub.retry_now`."""
        if self.mavlink is not None:
            self.mavlink.retry_now(container)

    def link_reports(self) -> list[dict[str, Any]]:
        """The MAVLink endpoints for `phm status`, see `MavlinkHub.report`."""
        return self.mavlink.report() if self.mavlink is not None else []

    def caught_up(self) -> bool:
        """Whether every reported Docker event is applied: see `ContainerWatcher.caught_up`."""
        return self.watch is None or self.watch.caught_up()

    def catch_up(self) -> None:
        """Wait until every reported Docker event is applied."""
        if self.watch is not None:
            self.watch.catch_up()

    def closers(self, *, links: bool = True) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What closes each part, by name, in order: links first, because they send a farewell. links: close them, too."""
        found: list[tuple[str, Callable[[], None]]] = []
        if links and self.mavlink is not None:
            found.append(("mavlink", self.mavlink.close))
        if self.ros is not None:
            found.append(("ros", self.ros.close))
        if self.reachability is not None:
            found.append(("reachability", self.reachability.stop))
        found += [
            ("file_watcher", self.file_watcher.close),
            ("sockets", self.sockets.close),
            ("serial", self.serial.close),
            ("matcher", self.matcher.close),
            ("programs", self.programs.close),
            ("logs", self.logs.close),
            ("devices", self.devices.close),
            ("host", self.host.close),
            ("received", self.received.close),
            ("engine", self.engine.close),
        ]
        if self.watch is not None:
            found.append(("watch", self.watch.stop))
        return tuple(found)

    def close(self) -> None:
        for _name, close in self.closers():
            close()


def build_probes(
    settings: Settings,
    clock: Clock,
    *,
    wake: Callable[[str], None],
    docker_event: Callable[[DockerEvent], None],
    note: Callable[[str], None],
    read_self: ReadSelf,
    hub: MavlinkHub | None = None,
) -> ProbeSet:
    """Build the probes that this configuration needs. hub: MAVLink endpoints that are open already (after a reload)."""
    engine = DockerEngine(settings.docker.socket, settings.docker.timeout, clock)
    fresh = Docker(engine, settings.containers, settings.docker, clock)
    docker = AttachmentCache(fresh)

    def happened(event: DockerEvent) -> None:
        fresh.invalidate()  # before a check is woken to read it again
        docker_event(event)

    watch = _container_watcher(settings, clock, engine, happened, wake)
    reachability = _reachability(settings, clock, fresh, wake)
    file_watcher = FileWatcher(clock)
    hub = hub or MavlinkHub(
        settings.mavlink,
        settings.agent.id,
        clock,
        settings.state_dir,
        clock_synchronized,
        settings.host.dev_root,
    )
    links = Links(hub, settings.agent.id, settings.mavlink, clock, lambda: wake("link"))
    swarm = SwarmMonitor(
        hub,
        settings.agent.id,
        settings.mavlink,
        settings.swarm,
        clock,
        gcs_age_s=links.gcs_age_s,
        on_wake=lambda: wake("swarm"),
        gcs_unreachable=links.gcs_unreachable,
    )
    ros = _ros_supervisor(settings, clock, wake, note)
    probe: RosProbe = ros if ros is not None else RosNotConfigured()
    devices = Devices(settings.host, clock, file_watcher, lambda: wake("device"), lambda: wake("other_device"))
    serial = SerialPorts(clock, devices.place)
    matcher = PatternMatcher(clock)
    logs = Logs(engine, docker.container, clock, matcher)
    programs = Programs(engine, docker.container, clock)
    sockets = Sockets(clock, matcher)
    host = Host(settings.host, clock)
    world = World(
        clock=clock,
        docker=docker,
        files=Files(docker, engine, settings.docker, clock, file_watcher, lambda: wake("file")),
        devices=devices,
        host=host,
        ros=probe,
        links=links,
        swarm=swarm,
        daemon=DaemonSelfProbe(read_self, ros, links),
        pressure=Pressure(engine, docker, settings.containers, settings.pressure, clock),
        environment=RosEnvironments(docker, settings.ros, clock),
        sockets=sockets,
        messages=MavlinkMessages(
            hub, settings.agent.id, settings.mavlink.endpoints, settings.custom, clock, links.autopilot
        ),
        serial=serial,
        programs=programs,
        logs=logs,
    )
    return ProbeSet(
        engine=engine,
        docker=docker,
        watch=watch,
        reachability=reachability,
        file_watcher=file_watcher,
        mavlink=hub if settings.mavlink.endpoints else None,
        ros=ros,
        sockets=sockets,
        serial=serial,
        matcher=matcher,
        programs=programs,
        logs=logs,
        devices=devices,
        host=host,
        received=links,
        agents=swarm,
        world=world,
    )


def _container_watcher(
    settings: Settings,
    clock: Clock,
    engine: DockerEngine,
    happened: Callable[[DockerEvent], None],
    wake: Callable[[str], None],
) -> ContainerWatcher | None:
    """None: no container is configured, and unknown ones are not reported."""
    if not settings.containers and settings.docker.unknown_containers.level == "off":
        return None
    return ContainerWatcher(
        engine,
        settings.containers,
        settings.docker,
        clock,
        on_event=happened,
        on_turn=lambda: wake("engine"),
        on_other=lambda: wake("other_container"),
    )


def _reachability(
    settings: Settings, clock: Clock, docker: Docker, wake: Callable[[str], None]
) -> ReachabilityMonitor | None:
    """None: no address of a container is to be checked."""
    if not any(entry.networks and entry.address for entry in settings.containers):
        return None
    return ReachabilityMonitor(clock, docker.answering, docker.ping, lambda: wake("network"))


def _ros_supervisor(
    settings: Settings, clock: Clock, wake: Callable[[str], None], note: Callable[[str], None]
) -> RosSupervisor | None:
    """None: nothing of ROS is configured."""
    ready = [entry.ready for entry in settings.containers if entry.ready is not None]
    if not (settings.ros.used or ready or uses_ros(settings.custom)):
        return None
    return RosSupervisor(
        settings.ros, settings.agent.name, clock, lambda: wake("ros"), note, ready=ready, custom=settings.custom
    )
