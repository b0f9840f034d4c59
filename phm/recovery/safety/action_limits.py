"""What keeps recovery from acting on one target now: holds, stops by an operator, the armed state."""

from __future__ import annotations

from phm.core.clock import Clock
from phm.recovery.actions.catalog import ActionCatalog
from phm.recovery.holds.hold_registry import BEING_STOPPED, Hold, HoldRegistry
from phm.recovery.safety.flight_critical import FlightCriticalGuard


class ActionLimits:
    """The limits of the target of this name, at the time of each call."""

    def __init__(
        self, target: str, catalog: ActionCatalog, holds: HoldRegistry, guard: FlightCriticalGuard, clock: Clock
    ) -> None:
        self._target, self._catalog, self._holds, self._guard, self._clock = target, catalog, holds, guard, clock

    def forbids(self, action: str) -> str:
        """Why the action must wait until the vehicle is disarmed; empty: it need not."""
        return self._guard.forbids(self._target, self._catalog.impact(action))

    def hold(self) -> Hold | None:
        """The hold that covers the target."""
        return self._holds.on(self._target, self._clock.mono())

    def undecided(self, *, ended: bool = False) -> float | None:
        """When it is decided whether an operator stopped it (monotonic seconds): see `HoldRegistry.undecided`."""
        return self._holds.undecided(self._target, self._clock.mono(), ended=ended)

    @property
    def stopped_by_hand(self) -> bool:
        """Whether an operator stopped it, and PHM only advises then (`recovery.on_manual_stop`)."""
        return self._holds.stopped_by_hand(self._target)

    @property
    def on_hold(self) -> bool:
        """Whether a hold covers the target, or it is not decided whether an operator stopped it."""
        return self.hold() is not None or self.undecided() is not None

    def why_on_hold(self) -> str:
        """The same as part of a sentence; empty: it is not on hold."""
        hold = self.hold()
        if hold is not None:
            return hold.words(self._clock.stamp())
        return BEING_STOPPED if self.undecided() is not None else ""
