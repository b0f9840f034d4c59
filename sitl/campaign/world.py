"""Observes the world during a trial: for each injected fault, from when on it is as it was before, whatever PHM says."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from docker import DockerClient
from docker.errors import DockerException

from sitl.campaign.trial import Injection
from sitl.faults.base import Agent, Fault

POLL_S = 0.2
FIRST_POLL_S, FIRST_S = 0.03, 3.0
"""How often at first: PHM reconnects a network 0.1 s after its loss, and a world that was never seen broken confirms nothing."""
JOIN_S = 30.0
"""Longer than one observation may take on a busy machine."""
Connect = Callable[[], DockerClient]


class WorldObserver:
    """Asks each fault's `restored` repeatedly, in a thread for each, from its injection until `stop`."""

    def __init__(
        self, faults: Mapping[str, Fault], agents: Mapping[int, Agent], connect: Connect = DockerClient.from_env
    ) -> None:
        self._faults, self._agents, self._connect = faults, agents, connect
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self, injections: Sequence[Injection]) -> None:
        """Watch these; one that is not injected yet is watched as soon as its injection begins."""
        self.stop()
        self._ending = threading.Event()
        self._threads = [
            threading.Thread(target=self._watch, args=(each, self._ending), name=f"world {each.fault}", daemon=True)
            for each in injections
        ]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End it, before anything is cleared."""
        self._ending.set()
        until = time.monotonic() + JOIN_S
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
        self._threads = []

    def _watch(self, injection: Injection, ending: threading.Event) -> None:
        client = self._connect()  # one for each thread: they are not safe to share
        try:
            agent = replace(self._agents[injection.agent], docker=client)
            while injection.asked is None:
                if ending.wait(FIRST_POLL_S) or injection.error:
                    return
            while not ending.is_set() and not (injection.moment is None and injection.error):
                began = time.monotonic()
                seen = self._ask(injection, agent)
                # Before the injection has ended, only a broken world says something: PHM may be faster than the injection's end.
                if not ending.is_set() and (injection.moment is not None or seen is False):
                    observe(injection, seen, began)
                ending.wait(FIRST_POLL_S if began - injection.asked < FIRST_S else POLL_S)
        finally:
            client.close()

    def _ask(self, injection: Injection, agent: Agent) -> bool | None:
        try:
            return self._faults[injection.fault].restored(agent)
        except (DockerException, LookupError, OSError, RuntimeError, ValueError):
            return False if injection.world_seen else None
        except Exception:  # e.g. a process that has just ended, or an archive that ends too early: nothing is known now
            injection.world = None
            return None


def observe(injection: Injection, restored: bool | None, mono: float) -> None:
    """Record one observation, begun at `mono`. Restored counts from the first of an unbroken series."""
    if restored is None:
        return
    injection.world_seen = True
    if not restored:
        injection.world = None
        if injection.world_broken is None:
            injection.world_broken = mono
    elif injection.world is None:
        injection.world = mono
