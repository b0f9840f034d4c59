"""What must not be disturbed while the vehicle may be armed: flight-critical containers, and what takes one of them down."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions.restart import dependents
from phm.recovery.base import Impact
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus


def critical_containers(containers: Sequence[ContainerSettings]) -> tuple[str, ...]:
    """Keys of the containers that are not acted on unless the vehicle is disarmed."""
    return tuple(entry.key for entry in containers if entry.flight_critical and entry.when_armed == "advise")


class FlightCriticalGuard:
    """Decides what is flight-critical now. armed: the state at the time of the call."""

    def __init__(
        self,
        containers: Sequence[ContainerSettings],
        container: Callable[[str], ContainerFact | None],
        myself: Callable[[], ContainerFact | None],
        armed: Callable[[], ArmedStatus],
    ) -> None:
        self._containers, self._container, self._myself, self.armed = containers, container, myself, armed
        self._critical = critical_containers(containers)

    def forbids(self, target: str, impact: Impact, approved_at: ArmedState | None = None) -> str:
        """Why nothing of this impact may be done to `target` now; empty: it may.

        approved_at: the armed state at which an operator approved it, which holds as long as that is the state.
        """
        if not self._critical or impact is Impact.OTHERS:
            return ""
        armed = self.armed()
        if not armed.restricts or armed.state is approved_at:
            return ""
        if target in self._critical:
            return f"flight-critical, and {armed.why}"
        if impact is Impact.NOTHING:
            return ""
        try:
            below = self._below(target, network_only=impact is Impact.NETWORK)
        except CannotTell as error:
            return f"what it would take down is not known ({error}), and {armed.why}"
        hit = next((key for key in below if key in self._critical), "")
        return f"it would take down {hit}, which is flight-critical, and {armed.why}" if hit else ""

    def key_of(self, ref: str) -> str:
        """The key of the configured container that the engine knows by this id or name; empty: none, or PHM's own.

        Raises CannotTell.
        """
        me = self._myself()
        if me is not None and ref in (me.id, me.name):
            return ""
        for entry in self._containers:
            fact = self._container(entry.key)
            if fact is not None and ref in (fact.id, fact.name):
                return entry.key
        return ""

    @property
    def inactive(self) -> bool:
        """Whether everything is allowed: no container is flight-critical, or the vehicle is disarmed."""
        return not self._critical or not self.armed().restricts

    def _below(self, target: str, *, network_only: bool) -> list[str]:
        facts = {entry.key: self._container(entry.key) for entry in self._containers}
        seen = {key: fact for key, fact in facts.items() if fact is not None}
        return dependents(target, seen, self._containers, network_only=network_only)
