"""Observes the application of every agent, without PHM: so that alarms about one into which nothing was injected can be confirmed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from docker import DockerClient
from docker.errors import DockerException
from docker.models.containers import Container

from sitl.campaign.application_alarms import LASTS_S
from sitl.campaign.observer_thread import ObserverThread
from sitl.campaign.trial import Broken
from sitl.faults._application import container_works
from sitl.faults.base import Agent

PERIOD_S = 1.0
JOIN_S = 30.0
"""Longer than one look at all agents may take on a busy machine."""
Connect = Callable[[], DockerClient]


class ApplicationWatcher:
    """Looks at all agents every PERIOD_S between `start` and `stop`, in a thread. What it has observed remains."""

    def __init__(self, agents: Mapping[int, Agent], connect: Connect = DockerClient.from_env) -> None:
        self._agents, self._connect = agents, connect
        thread = ObserverThread("applications", self._run, JOIN_S)
        self.start, self.stop = thread.start, thread.stop
        self._lock = threading.Lock()
        self._over: list[Broken] = []
        self._present: dict[int, Broken] = {}
        self._apps: dict[int, Container] = {}

    def begin(self) -> None:
        """A trial begins: drop what is too old to matter for it."""
        since = time.monotonic() - LASTS_S
        with self._lock:
            self._over = [each for each in self._over if each.ended >= since]

    def broken(self) -> list[Broken]:
        """Since shortly before `begin`, by time."""
        with self._lock:
            return sorted(
                (replace(each) for each in (*self._over, *self._present.values())), key=lambda each: each.began
            )

    def add(self, agent: int, mono: float, *, works: bool) -> None:
        """One observation, made at `mono`."""
        with self._lock:
            present = self._present.get(agent)
            if present is not None:
                present.ended = mono
            elif not works:
                self._present[agent] = Broken(agent, mono, mono)
            if works and present is not None:
                self._over.append(self._present.pop(agent))

    def _run(self, ending: threading.Event) -> None:
        client = self._connect()  # a client belongs to one thread
        agents = {number: replace(agent, docker=client) for number, agent in self._agents.items()}
        try:
            while not ending.wait(PERIOD_S):
                for number, agent in agents.items():
                    began = time.monotonic()
                    self.add(number, began, works=self._works(number, agent))
        finally:
            client.close()

    def _works(self, number: int, agent: Agent) -> bool:
        """The engine is asked only when the container that it described last does not work."""
        try:
            if number in self._apps and container_works(self._apps[number]):
                return True
            self._apps[number] = agent.app
            return container_works(self._apps[number])
        except (DockerException, LookupError, OSError, RuntimeError, ValueError):
            return False
