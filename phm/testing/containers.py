"""Fakes of the Docker Engine and of what is in containers."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

from phm.facts import (
    CannotTell,
    CgroupState,
    ConsumerFact,
    ContainerFact,
    EnvironmentDifference,
    FileFact,
    LogFact,
    LogMemory,
    OtherContainer,
    PressureFact,
    ProcessFact,
    ProgramFact,
    TreeFact,
)
from phm.testing.fake import Fake


def container(name: str = "ros_app", **fields: Any) -> ContainerFact:
    """A running container; `fields` replace those of `ContainerFact`."""
    running = ContainerFact(
        name=name, id=f"id-of-{name}", status="running", started_at="2026-01-01T00:00:00.000000001Z", pid=4242
    )
    return dataclasses.replace(running, **fields)


class FakeDocker(Fake):
    """Containers by name, networks (name -> id), addresses that do not answer, and PHM's own container.

    `drivers` holds the driver of each network, by its name; without an entry it is `bridge`.
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
        self.drivers: dict[str, str] = {}
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

    def container(self, name: str, young_s: float = 0.0) -> ContainerFact | None:
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

    def own_container(self) -> ContainerFact | None:
        self._asked()
        return self.me

    def others(self) -> tuple[OtherContainer, ...]:
        self._asked()
        return tuple(self.unknown)

    def network_id(self, name: str) -> str:
        self._asked()
        return self.networks.get(name, "")

    def network_driver(self, name: str) -> str:
        self._asked()
        return self.drivers.get(name, "bridge" if name in self.networks else "")

    def reachable(self, address: str) -> bool:
        self._asked()
        return address not in self.silent


class FakeFiles(Fake):
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

    def inspect(self, container: str, path: str, *, digest: bool) -> FileFact | None:
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


class FakePressure(Fake):
    """Counters of containers by name: with room for everything and no limit, until `put` or `change` says otherwise.

    `taken` lists who takes the CPUs. A container that was never put has counters that do not change. `states` are those of cgroups;
    of others they are unknown.
    """

    def __init__(self) -> None:
        super().__init__()
        self.facts: dict[str, PressureFact | None] = {}
        self.taken: tuple[ConsumerFact, ...] = ()
        self.states: dict[str, CgroupState] = {}
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

    def state(self, name: str, container_id: str) -> CgroupState | None:
        return self.states.get(name)

    def consumers(self) -> tuple[ConsumerFact, ...]:
        self.consumers_asked += 1
        self._asked()
        return self.taken


class FakeEnvironment(Fake):
    """Differences between the ROS environments of a container and of PHM, by container; none unless `found` has them."""

    def __init__(self) -> None:
        super().__init__()
        self.found: dict[str, tuple[EnvironmentDifference, ...]] = {}

    def differences(self, container: str) -> tuple[EnvironmentDifference, ...]:
        self._asked()
        return self.found.get(container, ())


class FakePrograms(Fake):
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


class FakeLogs(Fake):
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
