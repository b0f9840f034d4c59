"""Fakes for tests of checks, ours or anyone's: a clock that the test moves, and probes that hold facts.

Part of the public interface: authors of checks test them with these::

    from phm import testing

    def test_a_stopped_container_is_an_error():
        world = testing.world(docker=testing.FakeDocker(testing.container("ros_app", status="exited")))
        assert my_check.run(world).level is api.Level.ERROR

Each fake answers with the facts that it was given, until `fail` makes it raise `CannotTell`.
"""

from __future__ import annotations

import dataclasses
import re
import threading
import time
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from phm.core.clock import Clock, ClockSteps
from phm.core.model import Stamp
from phm.core.scheduling_delay import SchedulingDelay
from phm.core.settings import Settings
from phm.facts import (
    AutopilotFact,
    CannotTell,
    ConnectionFact,
    ConsumerFact,
    ContainerFact,
    DeviceFact,
    DeviceProbe,
    DiskFact,
    DockerProbe,
    EnvironmentDifference,
    EnvironmentProbe,
    FileFact,
    FileProbe,
    GcsFact,
    HostFact,
    HostProbe,
    HttpFact,
    LinkFact,
    LinkProbe,
    LogFact,
    LogMemory,
    LogProbe,
    MessageProbe,
    MessageValue,
    OtherContainer,
    PressureFact,
    PressureProbe,
    ProcessFact,
    ProgramFact,
    ProgramProbe,
    RadioFact,
    RosFact,
    RosProbe,
    SelfFact,
    SelfProbe,
    SerialFact,
    SerialProbe,
    SocketProbe,
    SwarmFact,
    SwarmProbe,
    TreeFact,
    World,
)

__all__ = [
    "FakeClock",
    "FakeDevices",
    "FakeDocker",
    "FakeEnvironment",
    "FakeFiles",
    "FakeHost",
    "FakeLinks",
    "FakeMessages",
    "FakePressure",
    "FakeRos",
    "FakeSelf",
    "FakeSerial",
    "FakeSwarm",
    "container",
    "settings",
    "world",
]

# An event may be set by any thread without notice to the clock, so sleepers look at it this often (real seconds).
_LOOK_S = 0.002


@dataclasses.dataclass(eq=False)
class _Sleeper:
    event: threading.Event
    until: float | None


class FakeClock:
    """A `phm.core.clock.Clock` that changes only when the test moves it.

    Invariant: a thread counts as sleeping only while neither its event is set nor its time is over, so
    that after `advance` a `wait_for_sleepers` waits for the woken threads to have done their work.
    """

    def __init__(self, mono: float = 1000.0, utc: float = 1_700_000_000.0) -> None:
        self._mono = mono
        self._utc = utc
        self.steps = ClockSteps()
        self.steps.note(Stamp(utc, mono))
        self._lateness = SchedulingDelay()
        self._sleepers: list[_Sleeper] = []
        self._moved = threading.Condition()

    def mono(self) -> float:
        with self._moved:
            return self._mono

    def utc(self) -> float:
        with self._moved:
            return self._utc

    def stamp(self) -> Stamp:
        with self._moved:
            return Stamp(utc=self._utc, mono=self._mono)

    def latest(self, utc: float) -> float:
        return self.steps.latest(utc)

    def advance(self, seconds: float) -> None:
        """Move both clocks forward and wake the threads whose time has come."""
        if seconds < 0:
            raise ValueError("the monotonic clock never goes back: use jump_utc")
        with self._moved:
            self._mono += seconds
            self._utc += seconds
            self.steps.note(Stamp(self._utc, self._mono))
            self._moved.notify_all()

    def be_late(self, seconds: float) -> None:
        """Move both clocks as `advance` does, while PHM does not run: time that `late_s` reports."""
        self._lateness.expect(self.mono())
        self.advance(seconds)
        self._lateness.came(self.mono())

    def late_s(self, since: float, most_s: float | None = None) -> float:
        return self._lateness.late_s(since, self.mono(), most_s)

    def jump_utc(self, seconds: float) -> None:
        """Set UTC forward or back, as an NTP client does; no sleeper wakes."""
        with self._moved:
            self._utc += seconds
            self.steps.note(Stamp(self._utc, self._mono))

    @property
    def sleepers(self) -> int:
        """How many threads wait now for time or for their event."""
        with self._moved:
            return self._count()

    def wait_for_sleepers(self, count: int, timeout_s: float = 5.0) -> None:
        """Block, in real time, until at least `count` threads wait; TimeoutError when they do not come."""
        limit = time.monotonic() + timeout_s
        with self._moved:
            while self._count() < count:
                if time.monotonic() >= limit:
                    raise TimeoutError(f"{self._count()} threads wait on the fake clock, expected {count}")
                self._moved.wait(_LOOK_S)

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        """As `phm.core.clock.Clock.wait`, in the time of this clock."""
        with self._moved:
            sleeper = _Sleeper(event, None if timeout_s is None else self._mono + timeout_s)
            self._sleepers.append(sleeper)
            try:
                while self._asleep(sleeper):
                    self._moved.wait(_LOOK_S)
                return event.is_set()
            finally:
                self._sleepers.remove(sleeper)

    def _asleep(self, sleeper: _Sleeper) -> bool:
        return not sleeper.event.is_set() and (sleeper.until is None or sleeper.until > self._mono)

    def _count(self) -> int:
        return sum(1 for sleeper in self._sleepers if self._asleep(sleeper))


class _Fake:
    """What all fakes can: fail on request, and count how often they were asked."""

    def __init__(self) -> None:
        self._problem: Exception | None = None
        self.calls = 0

    def fail(self, problem: str | Exception = "the fake fails on request") -> None:
        """From now on raise `problem`; a text becomes a `CannotTell`."""
        self._problem = CannotTell(problem) if isinstance(problem, str) else problem

    def work(self) -> None:
        """Answer again."""
        self._problem = None

    def _asked(self) -> None:
        self.calls += 1
        if self._problem is not None:
            raise self._problem


def container(name: str = "ros_app", **fields: Any) -> ContainerFact:
    """A running container; `fields` replace those of `ContainerFact`."""
    running = ContainerFact(
        name=name, id=f"id-of-{name}", status="running", started_at="2026-01-01T00:00:00.000000001Z", pid=4242
    )
    return dataclasses.replace(running, **fields)


class FakeDocker(_Fake):
    """Containers by name, networks (name -> id), addresses that do not answer, and PHM's own container.

    `lists` holds the processes of each container, by its name; without an entry the engine cannot tell them.
    """

    def __init__(
        self,
        *containers: ContainerFact,
        networks: Mapping[str, str] | None = None,
        me: ContainerFact | None = None,
        version: str = "27.0",
    ) -> None:
        super().__init__()
        self.containers = {fact.name: fact for fact in containers}
        self.networks = dict(networks or {})
        self.me = me
        self.version = version
        self.silent: set[str] = set()
        self.unknown: list[OtherContainer] = []
        """Containers that run and are not configured."""
        self.lists: dict[str, tuple[ProcessFact, ...]] = {}
        self.listings = 0
        """How often a list of processes was asked for."""
        self.problems: dict[str, Exception] = {}
        """Exceptions raised by questions about one container, by its name."""

    def put(self, fact: ContainerFact) -> None:
        self.containers[fact.name] = fact

    def change(self, name: str, **fields: Any) -> None:
        """Replace fields of one container's fact."""
        self.containers[name] = dataclasses.replace(self.containers[name], **fields)

    def remove(self, name: str) -> None:
        del self.containers[name]

    def engine(self) -> str:
        self._asked()
        return self.version

    def container(self, name: str) -> ContainerFact | None:
        self._asked()
        if name in self.problems:
            raise self.problems[name]
        return self.containers.get(name)

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        self.listings += 1
        fact = self.container(name)
        if fact is None or not fact.running or name not in self.lists:
            raise CannotTell(f"the processes of {name} are unknown")
        return self.lists[name]

    def myself(self) -> ContainerFact | None:
        self._asked()
        return self.me

    def others(self) -> tuple[OtherContainer, ...]:
        self._asked()
        return tuple(self.unknown)

    def network_id(self, name: str) -> str:
        self._asked()
        return self.networks.get(name, "")

    def reachable(self, address: str) -> bool:
        self._asked()
        return address not in self.silent


class FakeFiles(_Fake):
    """Files by (container, path); `put` adds an ordinary file."""

    def __init__(self) -> None:
        super().__init__()
        self.files: dict[tuple[str, str], FileFact] = {}
        self.problems: dict[tuple[str, str], Exception] = {}
        """Exceptions raised by questions about one file or folder."""
        self.trees: dict[tuple[str, str], TreeFact] = {}

    def put(self, container: str, path: str, **fields: Any) -> None:
        """Let a file be there: 100 bytes, mode 0644, no digest, seen through a volume, unless `fields` say else."""
        plain = FileFact(path, "file", 100, 0o644, executable=False, seen_through="volume")
        self.files[container, path] = dataclasses.replace(plain, **fields)

    def look(self, container: str, path: str, *, digest: bool) -> FileFact | None:
        self._asked()
        if (container, path) in self.problems:
            raise self.problems[container, path]
        fact = self.files.get((container, path))
        return fact if fact is None or digest else dataclasses.replace(fact, sha256="")

    def tree(self, container: str, path: str, *, manifest: str, ignore: Sequence[str]) -> TreeFact | None:
        """What `trees` holds for the container and the path."""
        self._asked()
        if (container, path) in self.problems:
            raise self.problems[container, path]
        return self.trees.get((container, path))


class FakeDevices(_Fake):
    """Devices by path on the host. `opened` lists the paths that a check asked to open."""

    def __init__(self) -> None:
        super().__init__()
        self.devices: dict[str, DeviceFact] = {}
        self.opened: list[str] = []
        self.ports: tuple[DeviceFact, ...] = ()

    def put(self, path: str, **fields: Any) -> None:
        """Let a character device be there that can be opened, unless `fields` say else."""
        plain = DeviceFact(path, character=True, major=188, minor=0, openable=True)
        self.devices[path] = dataclasses.replace(plain, **fields)

    def look(self, path: str, *, open_it: bool) -> DeviceFact | None:
        self._asked()
        if open_it:
            self.opened.append(path)
        return self.devices.get(path)

    def matching(self, patterns: Sequence[str]) -> tuple[DeviceFact, ...]:
        self._asked()
        facts = {fact.path: fact for path, fact in self.devices.items() if any(fnmatchcase(path, p) for p in patterns)}
        return tuple(facts[path] for path in sorted(facts))

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        self._asked()
        return self.ports


class FakeHost(_Fake):
    """A calm machine, until `change` says otherwise."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        calm = HostFact(
            cpu_percent=10.0,
            memory_percent=40.0,
            memory_available_bytes=2_000_000_000,
            disks=(DiskFact("/", 50.0, 10_000_000_000, 5.0, total_bytes=20_000_000_000),),
            load_per_core=0.2,
            temperature_c=50.0,
            temperature_of="cpu_thermal",
            throttled=(),
            clock_synchronized=True,
        )
        self.fact = dataclasses.replace(calm, **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def read(self) -> HostFact:
        self._asked()
        return self.fact


class FakePressure(_Fake):
    """Counters of containers by name: with room for everything and no limit, until `put` or `change` says otherwise.

    `taken` lists who takes the CPUs. A container that was never put has counters that do not change.
    """

    def __init__(self) -> None:
        super().__init__()
        self.facts: dict[str, PressureFact | None] = {}
        self.taken: tuple[ConsumerFact, ...] = ()
        self.consumers_asked = 0

    def put(self, name: str, fact: PressureFact | None) -> None:
        """The container's counters; None: it does not run."""
        self.facts[name] = fact

    def change(self, name: str, **fields: Any) -> None:
        """Replace fields of one container's fact."""
        fact = self.facts.get(name) or PressureFact(0.0, "cgroup v2")
        self.facts[name] = dataclasses.replace(fact, **fields)

    def container(self, name: str) -> PressureFact | None:
        self._asked()
        return self.facts.get(name, PressureFact(0.0, "cgroup v2"))

    def consumers(self) -> tuple[ConsumerFact, ...]:
        self.consumers_asked += 1
        self._asked()
        return self.taken


class FakeRos(_Fake):
    """A picture of the graph, fresh and taken by a child that has looked for a minute."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(RosFact(age_s=0.1, up_s=60.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def look(self) -> RosFact:
        self._asked()
        return self.fact


class FakeEnvironment(_Fake):
    """Differences between the ROS environments of a container and of PHM, by container; none unless `found` has them."""

    def __init__(self) -> None:
        super().__init__()
        self.found: dict[str, tuple[EnvironmentDifference, ...]] = {}

    def differences(self, container: str) -> tuple[EnvironmentDifference, ...]:
        self._asked()
        return self.found.get(container, ())


class FakeLinks(_Fake):
    """What was received on the MAVLink endpoints. `busy` holds the programs that have a serial port open, by its path."""

    def __init__(
        self,
        gcs_age_s: float | None = 1.0,
        autopilot: AutopilotFact | None = None,
        links: tuple[LinkFact, ...] = (),
        radios: tuple[RadioFact, ...] = (),
    ) -> None:
        super().__init__()
        self.gcs_age = gcs_age_s
        self.gcs_link = ""
        self.gcs_due_s: float | None = None
        self.gcs_overdue = False
        self.pilot = autopilot
        self.endpoints = links
        self.radio_facts = radios
        self.busy: dict[str, tuple[str, ...]] = {}

    def gcs_age_s(self) -> float | None:
        self._asked()
        return self.gcs_age

    def gcs(self) -> GcsFact | None:
        self._asked()
        if self.gcs_age is None:
            return None
        return GcsFact(self.gcs_age, 255, 190, self.gcs_link, self.gcs_due_s, self.gcs_overdue)

    def autopilot(self) -> AutopilotFact | None:
        self._asked()
        return self.pilot

    def radios(self) -> tuple[RadioFact, ...]:
        self._asked()
        return self.radio_facts

    def links(self) -> tuple[LinkFact, ...]:
        self._asked()
        return self.endpoints

    def users(self, path: str) -> tuple[str, ...]:
        self._asked()
        return self.busy.get(path, ())


class FakeSwarm(_Fake):
    """The swarm of an agent that is alone."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(SwarmFact(own=1, members=1, living=1, up_s=600.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def look(self) -> SwarmFact:
        self._asked()
        return self.fact


class FakeSelf(_Fake):
    """A PHM without problems."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(SelfFact(uptime_s=60.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def look(self) -> SelfFact:
        self._asked()
        return self.fact


class FakeSockets(_Fake):
    """Servers by host and port, and answers by URL; others refuse the connection."""

    def __init__(self) -> None:
        super().__init__()
        self.servers: dict[tuple[str, int], ConnectionFact] = {}
        self.pages: dict[str, HttpFact] = {}

    def connect(self, host: str, port: int, *, timeout_s: float, expect: str = "") -> ConnectionFact:
        self._asked()
        return self.servers.get((host, port), ConnectionFact("the connection was refused", 0.0))

    def get(self, url: str, *, timeout_s: float, pattern: str = "", verify_tls: bool = True) -> HttpFact:
        self._asked()
        fact = self.pages.get(url, HttpFact("the connection was refused", 0.0))
        return dataclasses.replace(fact, found=re.search(pattern, fact.body) is not None)


class FakePrograms(_Fake):
    """What programs answer, by container (empty: beside PHM) and first word; others cannot be started. `listed`: processes."""

    def __init__(self) -> None:
        super().__init__()
        self.answers: dict[tuple[str, str], ProgramFact] = {}
        self.listed: tuple[ProcessFact, ...] = ()

    def run(self, argv: Sequence[str], *, timeout_s: float, container: str = "") -> ProgramFact:
        self._asked()
        if (container, argv[0]) not in self.answers:
            raise CannotTell(f"{argv[0]} cannot be started")
        return self.answers[container, argv[0]]

    def processes(self) -> tuple[ProcessFact, ...]:
        self._asked()
        return self.listed


class FakeLogs(_Fake):
    """`lines`: what each reader finds next, by its name; read once."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: dict[str, list[str]] = {}
        self.memories: dict[str, LogMemory] = {}

    def memory(self, reader: str) -> LogMemory:
        return self.memories.setdefault(reader, LogMemory())

    def follow(
        self, reader: str, *, patterns: Sequence[str], timeout_s: float, path: str = "", container: str = ""
    ) -> LogFact:
        self._asked()
        lines = self.lines.pop(reader, [])
        found = [[line for line in lines if re.search(pattern, line)] for pattern in patterns]
        return LogFact(len(lines), tuple(map(len, found)), tuple(one[-1] if one else "" for one in found))


class FakeMessages(_Fake):
    """Values of fields of MAVLink messages, by message and field."""

    def __init__(self) -> None:
        super().__init__()
        self.fields: dict[tuple[str, str], tuple[MessageValue, ...]] = {}

    def values(self, message: str, field: str, *, component: int, instance: int | None) -> tuple[MessageValue, ...]:
        self._asked()
        found = self.fields.get((message, field), ())
        return tuple(value for value in found if instance in (None, value.instance))


class FakeSerial(_Fake):
    """What arrived on serial ports, by path."""

    def __init__(self) -> None:
        super().__init__()
        self.ports: dict[str, SerialFact] = {}

    def look(self, path: str, *, baud: int, line: str) -> SerialFact:
        self._asked()
        return self.ports.get(path, SerialFact(problem="it has not been opened yet"))


def world(
    *,
    clock: Clock | None = None,
    docker: DockerProbe | None = None,
    files: FileProbe | None = None,
    devices: DeviceProbe | None = None,
    host: HostProbe | None = None,
    ros: RosProbe | None = None,
    links: LinkProbe | None = None,
    swarm: SwarmProbe | None = None,
    myself: SelfProbe | None = None,
    pressure: PressureProbe | None = None,
    environment: EnvironmentProbe | None = None,
    sockets: SocketProbe | None = None,
    messages: MessageProbe | None = None,
    serial: SerialProbe | None = None,
    programs: ProgramProbe | None = None,
    logs: LogProbe | None = None,
) -> World:
    """A world of fakes, with those parts replaced that are given."""
    return World(
        clock=clock or FakeClock(),
        docker=docker or FakeDocker(),
        files=files or FakeFiles(),
        devices=devices or FakeDevices(),
        host=host or FakeHost(),
        ros=ros or FakeRos(),
        links=links or FakeLinks(),
        swarm=swarm or FakeSwarm(),
        myself=myself or FakeSelf(),
        pressure=pressure or FakePressure(),
        environment=environment or FakeEnvironment(),
        sockets=sockets or FakeSockets(),
        messages=messages or FakeMessages(),
        serial=serial or FakeSerial(),
        programs=programs or FakePrograms(),
        logs=logs or FakeLogs(),
    )


def settings(**yaml_like: Any) -> Settings:
    """Settings as if these top-level keys were in `phm.yaml`; raises pydantic's ValidationError."""
    return Settings.model_validate(yaml_like)
