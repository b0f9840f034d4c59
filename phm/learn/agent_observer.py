"""Watches an agent for `phm learn`, with PHM's own probes. It changes nothing: no container, no network, no MAVLink message."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from phm.core.clock import Clock
from phm.core.settings import ContainerSettings, Settings
from phm.facts import Attachment, CannotTell, ContainerFact
from phm.learn.autopilot_observer import AutopilotObserver
from phm.learn.baseline import IGNORED
from phm.learn.observations import Observations, ObservedContainer, ObservedFolder
from phm.learn.ros_observer import RosObserver
from phm.probes.devices import Devices
from phm.probes.docker import Docker
from phm.probes.docker_facts import container_fact, is_phm
from phm.probes.file_tree import TreeListing
from phm.probes.files import Files
from phm.transport.docker import DockerEngine, EngineRefused

NO_PROGRESS_S = 5.0
"""Reading a folder ends when no further file could be read for this long."""
_TURN_S = 0.2


@dataclass(frozen=True, slots=True)
class ObservationRequest:
    """What to watch. containers: their names or aliases; empty: those that are configured, else all that run.

    folders: containers and folders in them for which to make manifests. ros, links: whether to watch the ROS graph and the
    MAVLink endpoints.
    """

    for_s: float
    containers: tuple[str, ...] = ()
    folders: tuple[tuple[str, str], ...] = ()
    ros: bool = True
    links: bool = True


class ObservationFailed(Exception):
    """What was asked for cannot be watched at all; the text says why and what to do."""


@dataclass
class AgentObserver:
    """Observes one agent, once.

    progress: called with what happens now, in a few words, and the seconds that it takes (0: unknown).
    """

    settings: Settings
    request: ObservationRequest
    clock: Clock
    progress: Callable[[str, float], None] = lambda text, seconds: None
    problems: list[str] = field(default_factory=list)

    def run(self) -> Observations:
        """Raises ObservationFailed. Returns after `request.for_s`, and the time to read folders."""
        engine = DockerEngine(self.settings.docker.socket, self.settings.docker.timeout, self.clock)
        ros = RosObserver(self.settings.ros, self.settings.agent.name, self.clock) if self.request.ros else None
        pilot = (
            AutopilotObserver(self.settings.mavlink, self.settings.agent.id, self.clock, self.settings.host.dev_root)
            if self.request.links and self.settings.mavlink.endpoints
            else None
        )
        try:
            entries = self._entries(engine)
            docker = Docker(engine, list(entries.values()), self.settings.docker, self.clock)
            files = Files(docker, engine, self.settings.docker, self.clock)
            before = {key: self._container(docker, key) for key in entries}
            first = [self._folder(files, key, path) for key, path in self._folders(entries)]
            self._wait(ros, pilot)
            folders = [self._again(files, folder) for folder in first]
            devices = Devices(self.settings.host, self.clock)
            containers = [
                self._observed(docker, devices, key, fact) for key, fact in before.items() if fact is not None
            ]
            return self._observations(containers, folders, ros, pilot)
        finally:
            for part in (ros, pilot):
                if part is not None:
                    part.close()
            engine.close()

    # ------------------------------------------------------------ time

    def _wait(self, ros: RosObserver | None, pilot: AutopilotObserver | None) -> None:
        if pilot is not None:
            pilot.start()
        if ros is not None:
            self.progress("discovering the ROS graph", 0.0)
            ros.discover()
        self.progress(f"watching {'ROS topics' if ros is not None else 'the agent'}", self.request.for_s)
        tick, end_s = threading.Event(), self.clock.mono() + self.request.for_s
        while self.clock.mono() < end_s:
            self.clock.wait(tick, _TURN_S)
            for part in (ros, pilot):
                if part is not None:
                    part.tick()

    def _observations(
        self,
        containers: Sequence[ObservedContainer],
        folders: Sequence[ObservedFolder],
        ros: RosObserver | None,
        pilot: AutopilotObserver | None,
    ) -> Observations:
        seen = Observations(self.request.for_s, tuple(containers), tuple(folders))
        if ros is not None:
            seen = ros.into(seen)
        if pilot is not None:
            seen = pilot.into(seen)
        try:
            ports = Devices(self.settings.host, self.clock).serial_ports()
        except CannotTell as reason:
            ports = ()
            self.problems.append(f"serial ports cannot be listed: {reason}")
        return replace(seen, ports=ports, problems=(*self.problems, *seen.problems))

    # ------------------------------------------------------------ containers

    def _entries(self, engine: DockerEngine) -> Mapping[str, ContainerSettings]:
        """Settings of the containers to watch, by key."""
        known = {entry.key: entry for entry in self.settings.containers}
        names = {entry.name: entry.key for entry in known.values() if entry.name}
        wanted = self.request.containers or tuple(known)
        running: Sequence[str] = ()
        try:
            running = self._running(engine)
        except CannotTell as reason:
            configured = bool(wanted) and all(name in known or name in names for name in wanted)
            # PHM's proxy refuses the list of all containers, and only other names need it.
            if not (configured and isinstance(reason, EngineRefused)):
                if wanted or self.request.folders:
                    raise ObservationFailed(f"containers cannot be watched: {reason}") from None
                self.problems.append(f"containers were not watched: {reason}")
                return {}
        found: dict[str, ContainerSettings] = {}
        for name in wanted or running:
            key = name if name in known else names.get(name, name)
            if key not in known and name not in running:
                raise ObservationFailed(
                    f"there is no running container {name}; running: {', '.join(running) or 'none'}"
                )
            found[key] = known.get(key) or ContainerSettings(name=name)
        return found

    def _running(self, engine: DockerEngine) -> list[str]:
        """Names of the running containers without PHM's own and other containers that run PHM."""
        me = Docker(engine, (), self.settings.docker, self.clock).own_container()
        answers = [engine.inspect(str(one.get("Id"))) for one in engine.list() if one.get("State") == "running"]
        facts = [container_fact(answer) for answer in answers if not is_phm(answer)]
        return sorted(fact.name for fact in facts if me is None or fact.id != me.id)

    def _container(self, docker: Docker, key: str) -> ContainerFact | None:
        try:
            fact = docker.container(key)
        except CannotTell as reason:
            self.problems.append(f"container {key} cannot be read: {reason}")
            return None
        if fact is None or not fact.running:
            self.problems.append(
                f"container {key} {'does not exist' if fact is None else f'is {fact.status}'}: nothing is learned about it"
            )
            return None
        return fact

    def _observed(self, docker: Docker, devices: Devices, key: str, before: ContainerFact) -> ObservedContainer:
        now = self._container(docker, key) or before
        try:
            processes = docker.processes(key)
        except CannotTell:
            processes = ()
        answers = {entry.name: self._answers(docker, entry) for entry in now.networks}
        unseen, others = self._not_learned(devices, now)
        restarted = now.generation != before.generation
        return ObservedContainer(now, key, answers, processes, restarted, unseen, others)

    @staticmethod
    def _not_learned(devices: Devices, fact: ContainerFact) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Mapped paths that PHM does not see, and those that are no character devices."""
        unseen, others = [], []
        for path in (mapping.host_path for mapping in fact.devices):
            try:
                found = devices.inspect(path, open_it=False)
            except CannotTell:
                found = None
            if found is None:
                unseen.append(path)
            elif not found.character:
                others.append(path)
        return tuple(unseen), tuple(others)

    @staticmethod
    def _answers(docker: Docker, entry: Attachment) -> bool | None:
        """As the check of networks judges it: from the same network, or from the host's on a bridge.

        Elsewhere the silence of an address says nothing about it. A single lost echo is not a silent address.
        """
        if not entry.address:
            return None
        try:
            me = docker.own_container()
            if me is None or not any(one.network_id == entry.network_id for one in me.networks):
                on_host = me is None or me.network_mode == "host"
                if not on_host or docker.network_driver(entry.name) != "bridge":
                    return None
            return docker.reachable(entry.address) or docker.reachable(entry.address)
        except CannotTell:
            return None

    # ------------------------------------------------------------ folders

    def _folders(self, entries: Mapping[str, ContainerSettings]) -> Sequence[tuple[str, str]]:
        names = {entry.name: key for key, entry in entries.items()}
        for name, _path in self.request.folders:
            if name not in entries and name not in names:
                raise ObservationFailed(
                    f"--files names the container {name}, which is not watched; watched are: {', '.join(entries) or 'none'}"
                )
        return [
            (name if name in entries else names[name], path.rstrip("/") or "/") for name, path in self.request.folders
        ]

    def _folder(self, files: Files, key: str, path: str) -> ObservedFolder:
        self.progress(f"reading {key}:{path}", 0.0)
        listing = self._complete(files, key, path)
        return ObservedFolder(key, path, listing.sums, listing.size, (), tuple(sorted(listing.unreadable)))

    def _again(self, files: Files, first: ObservedFolder) -> ObservedFolder:
        """The folder with what has changed since it was first read."""
        now = self._complete(files, first.container, first.path)
        names = sorted(path for path in {**first.files, **now.sums} if first.files.get(path) != now.sums.get(path))
        kept = {path: total for path, total in now.sums.items() if path not in names}
        unreadable = tuple(sorted(now.unreadable | now.pending))
        return replace(first, files=kept, size=now.size, unstable=tuple(names), unreadable=unreadable)

    def _complete(self, files: Files, key: str, path: str) -> TreeListing:
        """With the checksums of all files but those that do not stay the same for long enough to be read."""
        pause, least, since_s = threading.Event(), (-1, 0), self.clock.mono()
        while True:
            try:
                listing = files.listing(key, path, IGNORED, fresh=True, partly=True)
            except CannotTell as reason:
                raise ObservationFailed(f"--files {key}:{path}: {reason}") from None
            if listing is None:
                raise ObservationFailed(f"--files {key}:{path}: the folder does not exist")
            done = len(listing.sums), listing.part
            if done > least:
                least, since_s = done, self.clock.mono()
            if not listing.pending or self.clock.mono() - since_s > NO_PROGRESS_S:
                return listing
            self.clock.wait(pause, _TURN_S)


def parse_folder(text: str) -> tuple[str, str]:
    """``CONTAINER:/path`` in parts. Raises ValueError."""
    container, colon, path = text.partition(":")
    if not container or not colon or not path.startswith("/") or fnmatchcase(path, "*/../*"):
        raise ValueError(f"{text!r} is not CONTAINER:/absolute/path")
    return container, path
