"""Injects the faults of a trial and clears them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from docker.errors import DockerException

from sitl.campaign.fault_catalog import explained, injection
from sitl.campaign.plan import Draw
from sitl.campaign.profiles import Profile
from sitl.campaign.trial import Injection
from sitl.campaign.world import WorldObserver
from sitl.faults.base import Agent, Fault

Wait = Callable[[Sequence[Future[None]]], object]
IsBad = Callable[[int, str], bool]
Note = Callable[[Fault, Agent], object]


class Injector:
    """is_bad: whether a unit of an agent already has an open fault. note: called just before each injection."""

    def __init__(
        self,
        faults: Mapping[str, Fault],
        agents: Mapping[int, Agent],
        profile: Profile,
        is_bad: IsBad,
        note: Note | None = None,
    ) -> None:
        self._note = note
        self._faults, self._agents, self._profile, self._is_bad = faults, agents, profile, is_bad
        self._world = WorldObserver(faults, agents)

    def stop(self) -> None:
        """Stop observing the world."""
        self._world.stop()

    def planned(self, draws: Sequence[Draw]) -> list[Injection]:
        """The records of these faults before their injection."""
        found = [injection(self._faults[draw.fault], self._agents[draw.agent], self._profile) for draw in draws]
        explained(found)
        return found

    def inject(self, injections: Sequence[Injection], wait: Wait) -> None:
        """Inject all in parallel; faults on one agent one after another, since a Docker client belongs to one thread.
        `wait` returns when all are done.
        """
        by_agent: dict[int, list[Injection]] = {}
        for each in injections:
            if self._is_bad(each.agent, each.unit):
                each.error = f"{each.unit} already has an open fault"
            else:
                by_agent.setdefault(each.agent, []).append(each)
        self._world.start([each for mine in by_agent.values() for each in mine])
        with ThreadPoolExecutor(len(by_agent) or 1) as pool:
            at_work = [pool.submit(self._inject_all, mine) for mine in by_agent.values()]
            wait(at_work)
        for future in at_work:
            future.result()
        # A cause that could not be injected explains nothing.
        explained([each for each in injections if each.moment is not None])

    def clear(self, injections: Sequence[Injection]) -> None:
        """In reverse order."""
        self._world.stop()
        for each in reversed(injections):
            if each.asked is None:
                continue
            agent = self._agents[each.agent]
            before = _generations(agent)
            each.cleared = time.monotonic()
            try:
                self._faults[each.fault].clear(agent)
            except Exception as error:  # the trial reports it; the swarm is restored by force if necessary
                each.error = f"clear: {type(error).__name__}: {error}"
            after = _generations(agent)
            each.renewed = None if before is None or after is None else before != after

    def _inject_all(self, mine: Sequence[Injection]) -> None:
        for each in mine:
            fault, agent = self._faults[each.fault], self._agents[each.agent]
            if self._note is not None:
                self._note(fault, agent)
            each.asked = time.monotonic()
            try:
                each.moment = fault.inject(agent)
            except Exception as error:  # one that cannot be injected is reported, and does not end the campaign
                each.error = f"{type(error).__name__}: {error}"


def _generations(agent: Agent) -> frozenset[str] | None:
    """None: not known now."""
    try:
        return agent.generations
    except (DockerException, LookupError, OSError):
        return None
