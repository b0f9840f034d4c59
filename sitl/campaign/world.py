"""Observes the world during a trial: for each injected fault, from when on it is as it was before, whatever PHM says."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from docker import DockerClient
from docker.errors import DockerException

from sitl.campaign.trial import INTERRUPTION_S, Injection
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
        series = Series(injection)
        try:
            agent = replace(self._agents[injection.agent], docker=client)
            while injection.asked is None:
                if ending.wait(FIRST_POLL_S) or injection.error:
                    return

            def watched() -> bool:
                # An interruption that is not decided yet is observed to its end.
                return not ending.is_set() or series.interrupted(time.monotonic())

            while watched() and not (injection.moment is None and injection.error):
                began = time.monotonic()
                seen = self._ask(injection, agent, series)
                # Before the injection has ended, only a broken world says something: PHM may be faster than the injection's end.
                if watched() and (injection.moment is not None or seen is False):
                    series.add(seen, began)
                time.sleep(FIRST_POLL_S if began - injection.asked < FIRST_S else POLL_S)
            series.close()
        finally:
            client.close()

    def _ask(self, injection: Injection, agent: Agent, series: Series) -> bool | None:
        try:
            return self._faults[injection.fault].restored(agent)
        except (DockerException, LookupError, OSError, RuntimeError, ValueError):
            return False if injection.world_seen else None
        except Exception:  # e.g. a process that has just ended, or an archive that ends too early: nothing is known now
            series.end()
            return None


class Series:
    """The observations of one injection, in order. Restored counts from the first of a series without an interruption of
    INTERRUPTION_S or more; shorter ones are counted.
    """

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        self._good: float | None = None
        self._bad: float | None = None

    def interrupted(self, mono: float) -> bool:
        """Whether the world was restored and has been observed broken since, at `mono` for too short a time to say that it was not."""
        return self._bad is not None and mono - self._bad < INTERRUPTION_S

    def add(self, restored: bool | None, mono: float) -> None:
        """One observation, begun at `mono`; None: the world cannot be observed."""
        if restored is None:
            return
        injection = self._injection
        injection.world_seen = True
        injection.interruptions = injection.interruptions or 0
        if restored:
            self._restored(mono)
            return
        if injection.world_broken is None:
            injection.world_broken = mono
        if self._bad is None and self._good is not None and mono - self._good >= INTERRUPTION_S:
            self._bad = mono
        if self._bad is None or mono - self._bad >= INTERRUPTION_S:
            self.end()

    def close(self) -> None:
        """There are no more observations. An interruption whose end was not observed has none."""
        if self._bad is not None:
            self.end()

    def end(self) -> None:
        """The world is not restored."""
        self._injection.world = self._good = self._bad = None

    def _restored(self, mono: float) -> None:
        injection = self._injection
        if injection.world is None:
            injection.world = mono
        if self._bad is not None:
            injection.interruptions = (injection.interruptions or 0) + 1
            injection.interrupted_s = round(injection.interrupted_s + mono - self._bad, 3)
        if self._good is None or self._bad is not None:
            self._good, self._bad = mono, None
