"""The engine as actions get it: before each call that changes something, the armed state is checked again.

Time passes between the decision and the call, and between the calls of one action: a slow stop, a dependent that another
recovery acts on. Every call of an action passes through here, also those of plug-ins.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, cast

from phm.recovery.safety.flight_critical import FlightCriticalError, FlightCriticalGuard, Impact
from phm.transport.docker import DockerEngine, EngineNotConnected, EngineTimeout, EngineUnreachable

READS = frozenset(
    {
        "ping",
        "version",
        "list",
        "running",
        "inspect",
        "inspect_network",
        "top",
        "stat_path",
        "read_file",
        "copy_file",
        "fetch_file",
        "events",
    }
)
"""Calls that change nothing; every other one is checked."""
REACH = {
    "start": Impact.NOTHING,
    "unpause": Impact.NOTHING,
    "exec_detached": Impact.NOTHING,
    "put_file": Impact.NOTHING,
    "set_cpu_shares": Impact.NOTHING,
    "connect": Impact.NETWORK,
    "disconnect": Impact.NETWORK,
}
"""What a call takes down; a call that is not listed: the container."""
BRINGS_BACK = frozenset({"start", "unpause", "connect"})
"""Never refused for what the same action took down: an action that is half done is worse than one that is complete."""
STARTS = frozenset({"start", "restart"})
"""Calls that start a container; the engine may still carry them out after it gave no answer."""
BEGINS_OR_ENDS = STARTS | {"stop", "kill"}
"""Calls after which the engine reports that a container ends or starts."""

Forbids = Callable[[str, Impact], str]


class GuardedEngine:
    """Has the methods of `DockerEngine`, for one run of one action. Those that change a container raise FlightCritical while that
    is forbidden."""

    def __init__(self, engine: DockerEngine, flight_critical_guard: FlightCriticalGuard, forbids: Forbids) -> None:
        """forbids: a container's key and what is taken down -> why not, empty: it may be done."""
        self._engine, self._guard, self._forbids = engine, flight_critical_guard, forbids
        self._down: set[str] = set()
        self._unanswered = 0
        self.disturbs = False
        """Whether a call that begins or ends the life of a container has been made: until then, a stop is an operator's."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._engine, name)
        if name in READS or not callable(found):
            return found

        def guarded(*args: Any, **kwargs: Any) -> Any:
            given = inspect.signature(found).bind(*args, **kwargs).arguments
            self._ask(name, str(given.get("container") or given.get("ref") or ""))
            self.disturbs |= name in BEGINS_OR_ENDS
            try:
                return found(*args, **kwargs)
            except EngineNotConnected:
                raise
            except (EngineTimeout, EngineUnreachable):
                self._unanswered += name in STARTS
                raise

        return guarded

    def take_unanswered(self) -> int:
        """How many calls that start a container were sent and not answered since the last `take_unanswered`."""
        count, self._unanswered = self._unanswered, 0
        return count

    def _ask(self, call: str, ref: str) -> None:
        """Raises FlightCritical, and CannotTell when the engine does not say which container is meant."""
        if not ref or (call in BRINGS_BACK and ref in self._down):
            return
        if not self._guard.inactive:
            key = self._guard.key_of(ref)
            why = self._forbids(key, REACH.get(call, Impact.CONTAINER)) if key else ""
            if why:
                raise FlightCriticalError(f"{call} of {key} was not done: {why}")
        if REACH.get(call) is not Impact.NOTHING and call not in BRINGS_BACK:
            self._down.add(ref)


def guarded(engine: DockerEngine, flight_critical_guard: FlightCriticalGuard, forbids: Forbids) -> DockerEngine:
    """The guarded engine, typed as the engine that actions use."""
    return cast(DockerEngine, GuardedEngine(engine, flight_critical_guard, forbids))
