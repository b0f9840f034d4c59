"""What must not be disturbed while the vehicle may be armed: flight-critical containers, and what takes one of them down."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions.restart import dependents
from phm.recovery.base import Impact
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.safety.namespaces import Inspect, described, with_owners


def critical_containers(containers: Sequence[ContainerSettings]) -> tuple[str, ...]:
    """Keys of the containers that are not acted on unless the vehicle is disarmed."""
    return tuple(entry.key for entry in containers if entry.flight_critical and entry.when_armed == "advise")


class FlightCriticalGuard:
    """Decides what is flight-critical now. armed: the state at the time of the call. inspect: asks the engine about any container."""

    def __init__(
        self,
        containers: Sequence[ContainerSettings],
        container: Callable[[str], ContainerFact | None],
        own_container: Callable[[], ContainerFact | None],
        armed: Callable[[], ArmedStatus],
        inspect: Inspect,
    ) -> None:
        self._containers, self._container, self._own_container, self.armed = containers, container, own_container, armed
        self._inspect = inspect
        self._critical = critical_containers(containers)

    def forbids(
        self,
        target: str,
        impact: Impact,
        approved_at: ArmedState | None = None,
        unconfigured: ContainerFact | None = None,
    ) -> str:
        """Why nothing of this impact may be done to `target` now; empty: it may.

        approved_at: the armed state at which an operator approved it, which holds as long as that is the state.
        unconfigured: `target` is this container's id, not a key of the configuration.
        """
        armed = self._restriction(approved_at)
        if armed is None or impact is Impact.OTHERS:
            return ""
        if target in self._critical:
            return f"flight-critical, and {armed.why}"
        if impact is Impact.NOTHING:
            return ""
        try:
            below = self._below(target, unconfigured, network_only=impact is Impact.NETWORK)
        except CannotTell as error:
            return f"what it would take down is not known ({error}), and {armed.why}"
        hit = next((key for key in below if key in self._critical), "")
        return f"it would take down {hit}, which is flight-critical, and {armed.why}" if hit else ""

    def refusal(self, call: str, ref: str, impact: Impact, approved_at: ArmedState | None) -> str:
        """Why an action may not make this call about the container `ref` now, as a sentence; empty: it may. Raises CannotTell.

        The engine says which container it means, because it also accepts "/name" and the beginning of an id.
        A flight-critical container may use the namespaces of one that is not configured, so that one is protected, too.
        """
        armed = self._restriction(approved_at)
        if armed is None:
            return ""
        if not ref:
            return f"{call} was not done: it names no container, so what it takes down is not known, and {armed.why}"
        called = described(self._inspect(ref), ref)
        me = self._own_container()
        if me is not None and called.id == me.id and impact is Impact.NETWORK:
            return ""  # PHM connects itself to networks
        key = next((entry.key for entry in self._containers if self._is(entry, called)), "")
        why = self.forbids(key or called.id, impact, approved_at, None if key else called)
        return f"{call} of {key or called.name} was not done: {why}" if why else ""

    def _restriction(self, approved_at: ArmedState | None) -> ArmedStatus | None:
        """The armed state if it restricts actions; None: everything is allowed."""
        armed = self.armed() if self._critical else None
        return armed if armed is not None and armed.restricts and armed.state is not approved_at else None

    def _is(self, entry: ContainerSettings, called: ContainerFact) -> bool:
        fact = self._container(entry.key)
        return fact is not None and fact.id == called.id

    def _below(self, target: str, unconfigured: ContainerFact | None, *, network_only: bool) -> list[str]:
        facts = {entry.key: self._container(entry.key) for entry in self._containers}
        seen = {key: fact for key, fact in facts.items() if fact is not None}
        if unconfigured is not None:
            seen[target] = unconfigured
        seen = with_owners(self._critical, seen, self._containers, self._inspect, network_only=network_only)
        return dependents(target, seen, self._containers, network_only=network_only)
