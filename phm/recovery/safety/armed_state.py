"""Whether the vehicle is armed, as far as recovery may rely on it.

Only a fresh HEARTBEAT of the vehicle's own autopilot that says disarmed counts as disarmed. In every other state recovery
does not disturb what is flight-critical: armed, silent, never received, contradictory heartbeats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from phm.core.clock import Clock
from phm.facts.links import REBOOT_SILENCE_S, AutopilotFact

REBOOT_S = 30.0
"""An autopilot that rebooted while armed reports disarmed at first, also in the air: ignored for this long."""


class ArmedState(str, Enum):
    """ARMED also if the last known state is armed; UNKNOWN: neither armed nor reliably disarmed."""

    DISARMED = "disarmed"
    ARMED = "armed"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class ArmedStatus:
    """The assessed state, and the evidence as text, e.g. ``the autopilot has been silent for 5 s``.

    undecided_s: for how long heartbeats cannot decide, however many arrive; 0: the next one may change the state.
    """

    state: ArmedState
    why: str
    undecided_s: float = 0.0

    @property
    def restricts(self) -> bool:
        """Whether flight-critical containers must not be disturbed."""
        return self.state is not ArmedState.DISARMED


@dataclass(frozen=True, slots=True)
class LastArmedState:
    """The part that survives a restart of PHM. since: when it was first observed (monotonic seconds)."""

    armed: bool
    since: float
    contradicted: bool = False
    """Its heartbeats contradicted each other: only a landing ends that."""


def assess(fact: AutopilotFact | None, timeout_s: float, last: LastArmedState | None = None) -> ArmedStatus:
    """timeout_s: maximum age of a heartbeat that counts (`mavlink.autopilot_timeout`). Pure."""
    if fact is None:
        return _never_received(last)
    if _within(fact.armed_s, timeout_s):
        if _within(fact.disarmed_s, timeout_s):
            words = f"reported armed {fact.armed_s:.1f} s ago and disarmed {fact.disarmed_s:.1f} s ago"
            return ArmedStatus(ArmedState.ARMED, f"the autopilot {words}")
        return ArmedStatus(ArmedState.ARMED, "the autopilot is armed")
    if not _within(fact.disarmed_s, timeout_s):
        silent = f"the autopilot has been silent for {fact.age_s:.0f} s"
        if fact.armed:
            return ArmedStatus(ArmedState.ARMED, f"{silent} and was armed")
        return ArmedStatus(ArmedState.UNKNOWN, silent)
    if fact.stalled_s is not None and fact.stalled_s <= timeout_s:
        why = "PHM was suspended and may have read old heartbeats of the autopilot"
        return ArmedStatus(ArmedState.UNKNOWN, why, timeout_s - fact.stalled_s)
    if contradicted(fact, last):
        why = "reported armed and disarmed by turns, and no landing since: another sender may use its id"
        return ArmedStatus(ArmedState.ARMED, f"the autopilot {why}")
    if fact.rebooted_armed and (fact.rebooted_s is None or fact.rebooted_s <= REBOOT_S):
        ago = "" if fact.rebooted_s is None else f" {fact.rebooted_s:.0f} s ago"
        return ArmedStatus(ArmedState.ARMED, f"the autopilot rebooted while armed{ago}")
    if last is not None and last.armed and not _landed(fact, timeout_s) and not _steadily_disarmed(fact, timeout_s):
        why = "was armed before a silence and may have rebooted in the air"
        return ArmedStatus(
            ArmedState.ARMED, f"the autopilot {why}: a disarmed report is trusted {REBOOT_S:.0f} s after the reboot"
        )
    return ArmedStatus(ArmedState.DISARMED, "the autopilot is disarmed")


def contradicted(fact: AutopilotFact | None, last: LastArmedState | None) -> bool:
    """Whether its heartbeats contradicted each other, in this run of PHM or in an earlier one, without a landing since."""
    if fact is not None and (fact.contradicted or fact.landed_s is not None):
        return fact.contradicted
    return last is not None and last.contradicted


def _never_received(last: LastArmedState | None) -> ArmedStatus:
    if last is None:
        return ArmedStatus(ArmedState.UNKNOWN, "no heartbeat of the autopilot was received")
    silent = "no heartbeat of the autopilot was received since PHM started"
    return (
        ArmedStatus(ArmedState.ARMED, f"{silent}, and it was armed before")
        if last.armed
        else ArmedStatus(ArmedState.UNKNOWN, silent)
    )


def _landed(fact: AutopilotFact, timeout_s: float) -> bool:
    """Whether a change from armed to disarmed was received, without a silence between in which it may have rebooted."""
    if fact.armed_s is None or fact.disarmed_for_s is None:
        return False
    return fact.armed_s - fact.disarmed_for_s <= min(timeout_s, REBOOT_SILENCE_S)


def _steadily_disarmed(fact: AutopilotFact, timeout_s: float) -> bool:
    """Whether it has been disarmed so long that a reboot missed by PHM does not explain it."""
    if fact.boot_s is not None and _within(fact.boot_age_s, timeout_s):
        return fact.boot_s >= REBOOT_S
    return fact.disarmed_for_s is not None and fact.disarmed_for_s >= REBOOT_S


def _within(age_s: float | None, limit_s: float) -> bool:
    return age_s is not None and age_s <= limit_s


class ArmedMonitor:
    """Assesses the state now and remembers the last one that was certain. Thread-safe."""

    def __init__(self, pilot: Callable[[], AutopilotFact | None], timeout_s: float, clock: Clock) -> None:
        self._pilot, self._timeout_s, self._clock = pilot, timeout_s, clock
        self._last: LastArmedState | None = None

    def restore(self, last: LastArmedState | None) -> None:
        """Take over the last state known to an earlier run of PHM."""
        self._last = last

    def now(self) -> ArmedStatus:
        fact = self._pilot()
        found = assess(fact, self._timeout_s, self._last)
        known = found.state is ArmedState.ARMED, contradicted(fact, self._last)
        certain = found.state is not ArmedState.UNKNOWN
        if certain and (self._last is None or (self._last.armed, self._last.contradicted) != known):
            self._last = LastArmedState(known[0], self._clock.mono(), known[1])
        return found

    def reported(self) -> bool | None:
        """Whether heartbeats received in this run of PHM say that it is armed; None: unknown, or only what was before says it.

        For a record of flights: after a loss of power in flight the flight did not last until the next start.
        """
        fact, state = self._pilot(), self.now().state
        if fact is None or state is ArmedState.UNKNOWN:
            return None
        if state is ArmedState.DISARMED:
            return False
        return True if fact.armed else None

    def kept(self) -> LastArmedState | None:
        """The last certain state, for the state file; it changes only when the state does."""
        self.now()
        return self._last
