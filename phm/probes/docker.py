"""The Docker probe: containers, networks and addresses as facts, from the engine's responses."""

from __future__ import annotations

import itertools
import re
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from phm.core import run_start
from phm.core.clock import Clock
from phm.core.settings import ContainerSettings, DockerSettings
from phm.facts import CannotTell, ContainerFact, NoResponse, OtherContainer, ProcessFact
from phm.probes import ping
from phm.probes.docker_facts import (
    TimeBudget,
    container_fact,
    find,
    is_configured,
    is_phm,
    other_container,
    summary_of,
)
from phm.probes.docker_processes import Processes
from phm.transport.docker import DockerEngine, EngineMissing

FRESH_S = 0.2
"""A response of this age is sufficient if it only leads to another request, and for PHM's own container."""
_OWN_CONTAINER = "\0own"  # no container can have this name
_ID = re.compile(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])")
_BY_DOCKER = ("/etc/hostname", "/etc/hosts", "/etc/resolv.conf")


@dataclass(frozen=True, slots=True)
class _Response:
    """To one request about a container, made at `asked_at` and answered at `done_at` (monotonic seconds)."""

    asked_at: float = float("-inf")
    done_at: float = float("-inf")
    generation: int = -1
    fact: ContainerFact | None = None
    error: CannotTell | None = None

    def result(self) -> ContainerFact | None:
        if self.error is not None:
            raise self.error.with_traceback(None)
        return self.fact


@dataclass(slots=True)
class _Entry:
    """The last response about one container: replaced with `lock` held, read by any thread."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    response: _Response = _Response()


class Docker:
    """Implements `phm.facts.DockerProbe`. Thread-safe; each method returns within the engine's timeout."""

    def __init__(
        self,
        engine: DockerEngine,
        containers: Sequence[ContainerSettings],
        settings: DockerSettings,
        clock: Clock,
        proc: Path = Path("/proc/self"),
    ) -> None:
        self._engine, self._clock, self._proc = engine, clock, proc
        self._containers = {entry.key: entry for entry in containers}
        self._own_container = settings.container
        self._entries = {key: _Entry() for key in (_OWN_CONTAINER, *self._containers)}
        self._generations = itertools.count(1)
        self._generation = 0
        self._my_id = ""
        self._processes = Processes(engine, clock)
        self._pinger = ping.Pinger()
        engine.on_change = self.invalidate

    def engine(self) -> str:
        return str(self._engine.version().get("Version") or "unknown version")

    def container(self, name: str, young_s: float = 0.0) -> ContainerFact | None:
        wanted = self._containers.get(name)
        if wanted is None:
            raise CannotTell(f"no container {name} is configured")
        return self._shared(name, lambda budget: find(self._engine, wanted, budget), young_s)

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        fact = self.container(name, FRESH_S)
        if fact is None or not fact.running:
            raise CannotTell(f"{name} is not running, so it has no processes")
        return self._processes.inspect(fact.id)

    def own_container(self) -> ContainerFact | None:
        return self._shared(_OWN_CONTAINER, self._find_own_container, FRESH_S)

    def others(self) -> tuple[OtherContainer, ...]:
        me = self.own_container()
        found = [
            other_container(entry)
            for entry in self._engine.running()
            if (me is None or entry.get("Id") != me.id)
            and not any(is_configured(wanted, entry) for wanted in self._containers.values())
        ]
        return tuple(sorted(found, key=lambda other: other.name))

    def network_id(self, name: str) -> str:
        """The id of the network with this name; empty if it does not exist. Raises CannotTell."""
        return str(self._network(name).get("Id") or "")

    def network_driver(self, name: str) -> str:
        return str(self._network(name).get("Driver") or "")

    def _network(self, name: str) -> Mapping[str, Any]:
        """The engine's data of the network with this name; empty if it does not exist. Raises CannotTell."""
        try:
            network = self._engine.inspect_network(name)
        except EngineMissing:
            return {}
        # The engine also accepts the beginning of an id as a name.
        return network if network.get("Name") == name else {}

    def reachable(self, address: str) -> bool:
        facts = [fact for entry in self._entries.values() if (fact := entry.response.fact) is not None]
        holder = next((fact for fact in facts if any(one.address == address for one in fact.networks)), None)
        return self._pinger.answers(address, holder.generation if holder is not None else "")

    def answering(self) -> tuple[str, ...]:
        """Addresses of configured containers that run and have responded in this run; see
        `phm.probes.reachability_monitor`."""
        facts = [entry.response.fact for key, entry in self._entries.items() if key != _OWN_CONTAINER]
        return tuple(
            one.address
            for fact in facts
            if fact is not None and fact.running
            for one in fact.networks
            if one.address and self._pinger.has_responded(one.address, fact.generation)
        )

    def ping(self, address: str) -> bool:
        """Whether the address responds right now: a single attempt, not a verdict."""
        return self._pinger.ping(address)

    def invalidate(self) -> None:
        """Invalidate earlier responses. Called with each Docker event and after each action of PHM."""
        self._generation = next(self._generations)

    # ------------------------------------------------------------ one request for all concurrent callers

    def _shared(
        self, key: str, ask: Callable[[TimeBudget], ContainerFact | None], young_s: float
    ) -> ContainerFact | None:
        """The response to a request that was made at most `young_s` before this call, or later. For the first call in the run of a
        check, the moment from which its results count takes the place of the call (`phm.core.run_start`).

        Threads that wait while another one asks share its next response.
        """
        entry, called_at = self._entries[key], run_start.oldest((self, key), self._clock.mono())
        last = entry.response
        if self._usable(last, called_at, young_s):
            return last.result()  # not waiting for a request that a busy engine has not answered yet
        # The holder of the lock releases it when its own deadline has passed.
        if not entry.lock.acquire(timeout=self._engine.timeout_s + 1):
            raise NoResponse(f"the Docker Engine is still answering an earlier request for {key.strip(chr(0))}")
        try:
            if not self._usable(entry.response, called_at, young_s):
                # Not before: meanwhile `reachable` must know which run has an address.
                entry.response = self._ask(ask)
            return entry.response.result()
        finally:
            entry.lock.release()

    def _usable(self, last: _Response, called_at: float, young_s: float) -> bool:
        if last.error is not None and last.done_at > called_at:
            return True  # failed while this thread waited: another attempt would only add up the deadlines
        return last.generation == self._generation and called_at - last.asked_at <= young_s

    def _ask(self, ask: Callable[[TimeBudget], ContainerFact | None]) -> _Response:
        asked_at, generation = self._clock.mono(), self._generation
        try:
            fact = ask(TimeBudget(self._clock, self._engine.timeout_s))
        except CannotTell as error:
            return _Response(asked_at, self._clock.mono(), generation, error=error)
        return _Response(asked_at, self._clock.mono(), generation, fact)

    # ------------------------------------------------------------ PHM's own container

    def _find_own_container(self, budget: TimeBudget) -> ContainerFact | None:
        configured = self._own_container
        if configured:
            try:
                return self._with_networks(self._engine.inspect(configured, deadline_s=budget.left_s()), budget)
            except EngineMissing as error:
                raise CannotTell(
                    f"PHM's own container {configured} (docker.container) does not exist: correct or remove the key"
                ) from error
        for candidate in [self._my_id] if self._my_id else own_ids(self._proc):
            try:
                answer = self._engine.inspect(candidate, deadline_s=budget.left_s())
            except EngineMissing:
                continue  # the id of a container of another engine, or a host name that looks like one
            fact = self._with_networks(answer, budget)
            if fact.id.startswith(candidate):
                self._refuse_application(answer, fact)
                self._my_id = fact.id
                return fact
        return None

    def _refuse_application(self, answer: Mapping[str, Any], fact: ContainerFact) -> None:
        """With the network namespace of another container, PHM has that one's /etc/hostname, and so its id (cgroup v2)."""
        listed = summary_of(answer)
        if not is_phm(answer) and any(is_configured(entry, listed) for entry in self._containers.values()):
            raise CannotTell(
                f"PHM shares the network of {fact.name} and cannot find its own container: set docker.container to its name"
            )

    def _with_networks(self, answer: Mapping[str, Any], budget: TimeBudget) -> ContainerFact:
        """With the networks of the container whose namespace it shares: PHM is on them, too."""
        fact = container_fact(answer)
        mode, _, owner = fact.network_mode.partition(":")
        if mode != "container":
            return fact
        try:
            there = container_fact(self._engine.inspect(owner, deadline_s=budget.left_s()))
        except EngineMissing:
            return fact
        return replace(fact, networks=there.networks)


def own_ids(proc: Path) -> list[str]:
    """Possible ids of PHM's own container, best evidence first; empty outside of containers.

    proc: the process's directory in /proc. The engine mounts /etc/hostname and similar files from a directory named
    after the id (cgroup v2 hides the id elsewhere). cgroup v1 has it in each path. The host name is its beginning
    unless the user chose another.
    """
    found: dict[str, None] = {}
    for line in _lines(proc / "mountinfo"):
        fields = line.split()
        # Only those mounted for this process: a host sees the mounts of all its containers.
        if len(fields) > 4 and fields[4] in _BY_DOCKER:
            found.update(dict.fromkeys(_ID.findall(fields[3])))
    for line in _lines(proc / "cgroup"):
        found.update(dict.fromkeys(_ID.findall(line)))
    name = socket.gethostname()
    if re.fullmatch(r"[0-9a-f]{12}", name):
        found.setdefault(name)
    return list(found)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
