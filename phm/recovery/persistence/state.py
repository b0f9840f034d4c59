"""What survives a restart of PHM: open faults, attempts, what was published, actions under way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from phm.core.model import Fault
from phm.recovery.base import LoweredWeight
from phm.recovery.fault_cases import AttemptRecord, PersistedCase, UnfinishedAction
from phm.recovery.holds.hold_registry import PersistedHold
from phm.recovery.ownership import Generation
from phm.recovery.safety.armed_state import LastArmedState


@dataclass(frozen=True, slots=True)
class RecoveryState:
    """Recovery's own part: attempts by target, cases by fault id, actions under way and generations of containers by target.

    unfinished: containers on which PHM was acting, dependents included, with the container to recover.
    """

    attempts: Mapping[str, tuple[AttemptRecord, ...]] = field(default_factory=dict)
    cases: Mapping[str, PersistedCase] = field(default_factory=dict)
    under_way: Mapping[str, UnfinishedAction] = field(default_factory=dict)
    generations: Mapping[str, Generation] = field(default_factory=dict)
    armed: LastArmedState | None = None
    """The last certain armed state of the vehicle."""
    unfinished: Mapping[str, str] = field(default_factory=dict)
    holds: tuple[PersistedHold, ...] = ()
    stops: tuple[str, ...] = ()
    """Containers that an operator stopped, where PHM only advises then."""
    windows: tuple[tuple[str, str], ...] = ()
    """Maintenance windows that are over, by target and occurrence."""
    lowered: tuple[LoweredWeight, ...] = ()
    """CPU weights to put back."""


@dataclass(frozen=True, slots=True)
class PersistedState:
    """Everything that the state file keeps."""

    faults: tuple[Fault, ...] = ()
    given_up: tuple[Fault, ...] = ()
    recovery: RecoveryState = field(default_factory=RecoveryState)
    clock: tuple[tuple[float, float], ...] = ()
    """How the UTC clock was set on this start of the machine, as far as PHM has seen (`phm.core.clock.ClockSteps.kept`)."""
    fault_count: int = 0
    """The number of the last fault that was opened."""
