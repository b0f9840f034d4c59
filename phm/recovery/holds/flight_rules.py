"""Which holds the armed state of the vehicle forbids."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence

from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions.restart import dependents
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.safety.namespaces import Inspect, with_owners


class FlightRules:
    """facts: the newest of each container, by which dependents are known; the caller updates it. inspect: see
    `phm.recovery.safety.namespaces`."""

    def __init__(
        self,
        containers: Sequence[ContainerSettings],
        status: Callable[[], ArmedStatus],
        facts: Mapping[str, ContainerFact],
        inspect: Inspect,
    ) -> None:
        self._containers, self._status, self._facts, self._inspect = containers, status, facts, inspect
        self._critical = {entry.key for entry in containers if entry.flight_critical}
        self._known: Mapping[str, ContainerFact] = {}

    @property
    def armed(self) -> bool:
        """Whether the vehicle is armed for certain."""
        return self._status().state is ArmedState.ARMED

    def observe(self) -> None:
        """Ask the engine about containers that are not configured and that a flight-critical one needs; a hung one takes its time."""
        with contextlib.suppress(CannotTell):  # what was known before stays: a container never changes its namespaces
            self._known = with_owners(self._critical, dict(self._facts), self._containers, self._inspect)

    def critical(self, keys: Iterable[str]) -> bool:
        """Whether one of these containers is flight-critical, or takes a flight-critical one down."""
        critical, facts = self._critical, {**self._known, **self._facts}
        return bool(critical) and any(critical & {key, *dependents(key, facts, self._containers)} for key in keys)

    def refusal(self, keys: Sequence[str]) -> str:
        """Why these must not be put on hold now, as part of a sentence; empty: they may be."""
        if not (self.armed and self.critical(keys)):
            return ""
        return "cannot be put on hold while the autopilot is armed: it, or a container that depends on it, is flight-critical"

    def warning(self, keys: Sequence[str]) -> str:
        """What an operator must know who puts something flight-critical on hold while the armed state is unknown.

        Such a hold is not refused: it changes nothing, and a bench has no autopilot. An autopilot that was armed and is silent
        counts as armed.
        """
        status = self._status()
        if status.state is not ArmedState.UNKNOWN or not self.critical(keys):
            return ""
        return f"; the vehicle is not known to be disarmed ({status.why}): the hold ends when the autopilot is armed"
