"""Makes the parts that touch the outside: the engine's client, probes, MAVLink endpoints, the ROS child.

One place knows which class stands behind which protocol of `phm.facts`; the daemon only holds `Components`.
Nothing is opened by making the parts: that is `start`'s doing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import Settings
from phm.facts import COMPLETE, Attachment, CannotTell, EventStreamFact, LinkFact, RosFact, RosProbe, SelfFact, World
from phm.probes.attachment_cache import RememberingDocker
from phm.probes.devices import Devices
from phm.probes.docker import Docker
from phm.probes.docker_events import DockerEvent, Watch
from phm.probes.files import Files
from phm.probes.host import Host, clock_synchronized
from phm.probes.inotify import Notices
from phm.probes.links import Links
from phm.probes.pressure import Pressure
from phm.probes.reachability_monitor import Pulse
from phm.probes.ros.supervisor import RosProcess
from phm.probes.swarm import Swarm
from phm.transport.docker import Engine
from phm.transport.mavlink import MavlinkHub

ReadSelf = Callable[[], SelfFact]
"""What the daemon knows of itself."""


class RosNotConfigured:
    """Stands in where the configuration names no node and no topic: no child process is started."""

    def look(self) -> RosFact:
        raise CannotTell("no ROS node or topic is configured")


@dataclass(frozen=True)
class SelfProbe:
    """PHM as a probe of itself: the daemon's own knowledge and the ROS child's restarts."""

    self_look: ReadSelf
    ros: RosProcess | None
    links: Links

    def look(self) -> SelfFact:
        fact = self.self_look()
        if self.ros is not None:
            fact = replace(fact, problems=(*fact.problems, *self.ros.problems()), ros_restarts=self.ros.restarts)
        return replace(fact, problems=(*fact.problems, *self.links.problems()))


@dataclass(frozen=True)
class Components:
    """Everything that has threads or sockets of its own, and the world made of it."""

    engine: Engine
    docker: RememberingDocker
    watch: Watch | None
    pulse: Pulse | None
    notices: Notices
    mavlink: MavlinkHub | None
    ros: RosProcess | None
    world: World

    def start(self, *, links: bool = True) -> None:
        """Links, unless they run already, and the event stream; the ROS child starts separately, after networks are joined."""
        if links and self.mavlink is not None:
            self.mavlink.start()
        if self.watch is not None:
            self.watch.start()
        if self.pulse is not None:
            self.pulse.start()

    def event_stream(self) -> EventStreamFact:
        """The engine's event stream now; complete when no container is configured."""
        return self.watch.fact if self.watch is not None else COMPLETE

    def start_ros(self) -> None:
        if self.ros is not None:
            self.ros.start()

    def renew_ros(self, reason: str) -> None:
        """A DDS participant keeps the interfaces it found at its start: after a change it is made anew."""
        if self.ros is not None:
            self.ros.renew(reason)

    def links(self) -> tuple[LinkFact, ...]:
        return self.mavlink.links() if self.mavlink is not None else ()

    def link(self, name: str) -> LinkFact | None:
        """The MAVLink endpoint of this name, with its traffic."""
        return next((link for link in self.world.links.links() if link.name == name), None)

    def reopen(self, link: str, timeout_s: float) -> bool:
        """See `MavlinkHub.reopen`."""
        return self.mavlink is not None and self.mavlink.reopen(link, timeout_s)

    def begun(self, container: str) -> None:
        """A configured container has been started: see `MavlinkHub.hurry`."""
        if self.mavlink is not None:
            self.mavlink.hurry(container)

    def link_reports(self) -> list[dict[str, Any]]:
        """The MAVLink endpoints for `phm status`, see `MavlinkHub.report`."""
        return self.mavlink.report() if self.mavlink is not None else []

    def remembered(self, container: str, network: str) -> Attachment | None:
        return self.docker.remembered(container, network)

    def caught_up(self) -> bool:
        """Whether all that the engine has reported is applied: see `Watch.caught_up`."""
        return self.watch is None or self.watch.caught_up()

    def catch_up(self) -> None:
        """Wait until it is."""
        if self.watch is not None:
            self.watch.catch_up()

    def closers(self, *, links: bool = True) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What ends each part, by name: those that have somebody to say goodbye to come first. `links`: these as well."""
        found: list[tuple[str, Callable[[], None]]] = []
        if links and self.mavlink is not None:
            found.append(("mavlink", self.mavlink.close))
        if self.ros is not None:
            found.append(("ros", self.ros.close))
        if self.pulse is not None:
            found.append(("pulse", self.pulse.stop))
        found += [("notices", self.notices.close), ("engine", self.engine.close)]
        if self.watch is not None:
            found.append(("watch", self.watch.stop))
        return tuple(found)

    def close(self) -> None:
        for _name, close in self.closers():
            close()


def build_components(
    settings: Settings,
    clock: Clock,
    *,
    wake: Callable[[str], None],
    docker_event: Callable[[DockerEvent], None],
    note: Callable[[str], None],
    self_look: ReadSelf,
    hub: MavlinkHub | None = None,
) -> Components:
    """Make the parts that this configuration needs; see `Components.start` for when they begin. `hub`: one that runs already."""
    engine = Engine(settings.docker.socket, settings.docker.timeout, clock)
    asked = Docker(engine, settings, clock)
    docker = RememberingDocker(asked)

    def happened(event: DockerEvent) -> None:
        asked.invalidate()  # what was read a moment ago is old before anybody is woken to read it
        docker_event(event)

    watch = Watch(engine, settings, clock, happened, lambda: wake("engine")) if settings.containers else None
    pulse = Pulse(clock, asked.answering, asked.knock, lambda: wake("network")) if _addressed(settings) else None
    notices = Notices(clock)
    hub = hub or MavlinkHub(settings.mavlink, settings.agent.id, clock, settings.state_dir, clock_synchronized)
    links = Links(hub, settings, clock, lambda: wake("link"))
    swarm = Swarm(hub, settings, clock, links.gcs_age_s, lambda: wake("swarm"), links.deaf)
    ros = RosProcess(settings, clock, lambda: wake("ros"), note) if settings.ros.used else None
    probe: RosProbe = ros if ros is not None else RosNotConfigured()
    world = World(
        clock=clock,
        docker=docker,
        files=Files(docker, engine, settings, clock, notices, lambda: wake("file")),
        devices=Devices(settings, clock, notices, lambda: wake("device")),
        host=Host(settings, clock),
        ros=probe,
        links=links,
        swarm=swarm,
        myself=SelfProbe(self_look, ros, links),
        pressure=Pressure(engine, docker, settings, clock),
    )
    return Components(engine, docker, watch, pulse, notices, hub if settings.mavlink.endpoints else None, ros, world)


def _addressed(settings: Settings) -> bool:
    """Whether some container's address must answer."""
    return any(entry.networks and entry.address for entry in settings.containers)
