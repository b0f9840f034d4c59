"""Pings addresses that have responded, and reports immediately when one falls silent or responds again.

Inspecting a network takes three requests to the engine, a ping two packets. So the check runs every few seconds, and
this monitor pings in between. It draws no conclusion: a lost ping only wakes the check.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable

from phm.core import threads
from phm.core.clock import Clock
from phm.facts import CannotTell

logger = logging.getLogger(__name__)

PERIOD_S = 1.0
GIVEN_UP_S = 30.0
"""An address silent for longer is left to the check's own period: usually its container has ended."""
MOST = 32


class ReachabilityMonitor:
    """One thread. `turned` is called when an address has fallen silent or responds again.

    addresses: those that have responded. ping: whether one responds within its timeout; may raise CannotTell.
    """

    def __init__(
        self,
        clock: Clock,
        addresses: Callable[[], Iterable[str]],
        ping: Callable[[str], bool],
        turned: Callable[[], None],
    ) -> None:
        self._clock, self._addresses, self._ping, self._turned = clock, addresses, ping, turned
        self._silent_since: dict[str, float] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-reachability", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def stop(self) -> None:
        self._stopping.set()

    def poll(self) -> None:
        """Ping each address once."""
        addresses = list(self._addresses())[:MOST]
        self._silent_since = {known: since for known, since in self._silent_since.items() if known in addresses}
        for address in addresses:
            now = self._clock.mono()
            since = self._silent_since.get(address)
            if self._stopping.is_set() or (since is not None and now - since > GIVEN_UP_S):
                continue
            there = self._ping(address)
            if there and since is not None:
                del self._silent_since[address]
            elif not there and since is None:
                self._silent_since[address] = now
            if there is not (since is None):
                self._turned()

    def _loop(self) -> None:
        while not self._clock.wait(self._stopping, PERIOD_S):
            try:
                self.poll()
            except CannotTell as error:
                logger.debug("addresses cannot be pinged: %s", error)
            except Exception:  # a defect here must not end the watch
                logger.exception("pinging an address failed")
