"""Decides what to do about a fault. Pure: fault, history and what is forbidden in, a decision out.

Rules, first match wins: no ladder for the condition -> nothing; never well in this life of its container, where
only that gives hope -> nothing; mode off -> nothing; not opted in ->
nothing; on hold -> wait until its end; not decided yet whether it is being stopped by hand -> wait for that;
the same failure `same_failure` times -> give up and say so; forbidden while armed
-> advise; stopped by hand where that is only advised about -> advise; mode
advise -> advise; budget used up -> wait, and say so; back-off not over -> wait; else the rung of the ladder that
follows the number of failed attempts. Actions on PHM's own container and links are bound by budget and back-off alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from phm.model import NEVER_WELL, Fault
from phm.recovery.history import Attempt, History
from phm.recovery.holds import BEING_STOPPED
from phm.settings import ContainerSettings, RecoverySettings

HOLD = "hold"
CLEAN_S = 600.0
"""After this long without an attempt, back-off starts anew (the issue's figure: 10 minutes)."""

LADDERS: Mapping[str, tuple[str, ...]] = {
    "exited": ("start", "restart"),
    "oom": ("start", "restart"),
    "created": ("start",),
    "paused": ("unpause", "restart"),
    "unhealthy": ("restart",),
    "disconnected": ("reconnect", "restart"),
    "address_silent": ("reconnect", "restart"),
    "sidecar_apart": ("join",),
    "node_missing": ("relaunch", "restart"),
    "node_hung": ("restart",),
    "silent": ("relaunch", "restart"),
    "rate_low": ("relaunch", "restart"),
    "publisher_lost": ("restart",),
    "subscriber_lost": ("restart",),
    "qos_mismatch": ("restart",),
    "node_twice": ("restart",),
    "transport_blocked": ("restart",),
    "file_missing": ("restore",),
    "file_not_executable": ("restore",),
    "file_altered": ("restore",),
    "device_replugged": ("restart",),
    "link_silent": ("reopen",),
    "radio_silent": ("reopen",),
    "autopilot_silent": ("reopen",),
    "disk_full": ("make_room",),
}
"""Built-in ladders by condition. Conditions that are not here are told and left alone: `restarting` because the engine's
own restart policy is at work and is not fought, `dead` because the engine refuses to restart what it could not remove,
`not_received` because a transport that was never open outlives every restart."""
PATIENT = frozenset({"silent", "rate_low", "publisher_lost", "subscriber_lost", "qos_mismatch", "node_twice"})
"""Conditions that must have lasted `recovery.patience`: a source that pauses is not yet one that hangs, and a node may make
its ends anew by itself, or be relieved by a copy that starts before it ends."""
OUTSIDE = frozenset({"network_missing"})
"""Conditions that come from outside of every container. An action after which a unit has one of them is not to blame."""
AGAIN_WHILE_IT_LASTS = frozenset({"disconnected"})
"""Conditions that only the first step of the ladder can end: a restart connects nothing. The next step is for what needs the unit
and has not come back after the unit itself did."""
ONCE_WELL = frozenset({"transport_blocked", "qos_mismatch", "node_twice"})
"""Conditions that a restart ends only where the container's own start is not their cause: firewall rules of its network
namespace, a publisher that was made anew, a second node started by hand. Where it was well in this life, a restart brings
back what the start had, and is tried once; where it never was, nothing is done. A ladder of the user's own holds as it is."""
ONCE_WELL_S, FOUND_WELL_S = 2.0, 5.0
"""What has been told well for longer was not wrong from the start: beyond the grace of that start, in which all comes up and names
of the life before go; where the container ran before PHM did, since PHM looks. A check that knows better says so
(`phm.model.NEVER_WELL`)."""


@dataclass(frozen=True, slots=True)
class Act:
    action: str
    attempt: int


@dataclass(frozen=True, slots=True)
class Advise:
    """Say what would help; do nothing. `again_at` None: final for this fault."""

    action: str
    why: str
    again_at: float | None = None


@dataclass(frozen=True, slots=True)
class Wait:
    """subject: what it is published as, each once."""

    until: float
    why: str
    tell: bool = False
    subject: str = "wait"


@dataclass(frozen=True, slots=True)
class GiveUp:
    action: str
    why: str


@dataclass(frozen=True, slots=True)
class Leave:
    """Nothing that PHM may or can do."""

    why: str


Decision = Act | Advise | Wait | GiveUp | Leave
ARMED_AGAIN_S = 2.0


def decide(
    fault: Fault,
    history: History,
    now: float,
    *,
    container: ContainerSettings | None,
    forbids: Callable[[str], str],
    settings: RecoverySettings,
    free_actions: frozenset[str] = frozenset(),
    approved: bool = False,
    usable: frozenset[str] | None = None,
    start_s: float = 8.0,
    hold: tuple[float, str] | None = None,
    undecided: float | None = None,
    stopped_by_hand: bool = False,
) -> Decision:
    """What to do about `fault` at `now` (monotonic seconds).

    forbids: why an action must not be done while the vehicle may be armed; empty: it may (`phm.recovery.critical`).
    approved: an operator has approved this action: mode advise and the armed state no longer hold it back.
    free_actions: actions on PHM's own container and links; they endanger nobody, so mode, opt-in and arming do not bind them.
    usable: the actions that apply to this fault; other rungs are left out. None: all.
    hold: until when (monotonic seconds) the container is on hold, and that in words; None: it is not.
    undecided: when it is decided whether an operator is stopping the container (monotonic seconds); None: it is decided.
    stopped_by_hand: an operator stopped the container, and then PHM only advises (`recovery.on_manual_stop`).
    start_s: how long the parts of a container may take to come up (`ros.grace`).
    """
    condition = fault.result.condition
    ladder = tuple(rung for rung in ladder_of(condition, settings) if usable is None or rung in usable)
    hopeless = _hopeless(fault, ladder, settings, start_s)
    if hopeless:
        return Leave(hopeless)
    same = _same_failures(history, fault, now, settings.verify)
    action = _rung(ladder, condition, same, settings)
    if action not in free_actions:
        refused = _refused(container, settings, hold, undecided)
        if refused is not None:
            return refused
    if len(same) >= (1 if _once(condition, settings) else settings.same_failure):
        return GiveUp(action, _in_vain(len(same)))
    if condition in PATIENT and now < fault.opened.mono + settings.patience:
        return Wait(fault.opened.mono + settings.patience, "it may come back by itself")
    bound = action not in free_actions and not approved
    forbidden = forbids(action) if bound else ""
    if forbidden:
        return Advise(action, forbidden, again_at=now + ARMED_AGAIN_S)
    if bound and stopped_by_hand:
        return Advise(action, "it was stopped by hand, recovery.on_manual_stop is advise")
    if bound and settings.mode == "advise":
        return Advise(action, "recovery only advises")
    recent = history.within(now - settings.window)
    if len(recent) >= settings.budget:
        return Wait(recent[0].at + settings.window, f"budget of {settings.budget} actions used up", tell=True)
    ready = _ready_at(history, fault, now, settings)
    if now < ready:
        return Wait(ready, "backing off")
    return Act(action, len(same) + 1)


def _refused(
    container: ContainerSettings | None,
    settings: RecoverySettings,
    hold: tuple[float, str] | None,
    undecided: float | None,
) -> Leave | Wait | None:
    """Why nothing may be done to the container, whatever is wrong with it."""
    if settings.mode == "off":
        return Leave("recovery is off")
    if container is None:
        return Leave("no container to act on")
    if not container.recover:
        return Leave(f"{container.key} has not opted in (recover: true)")
    if hold is not None:
        return Wait(hold[0], hold[1], tell=True, subject=HOLD)
    return Wait(undecided, BEING_STOPPED) if undecided is not None else None


def ladder_of(condition: str, settings: RecoverySettings) -> tuple[str, ...]:
    """The user's ladder for the condition, else the built-in one, else none."""
    return tuple(settings.ladders.get(condition, LADDERS.get(condition, ())))


def _rung(ladder: tuple[str, ...], condition: str, same: list[Attempt], settings: RecoverySettings) -> str:
    """The step that follows so many failed attempts."""
    again = condition in AGAIN_WHILE_IT_LASTS and condition not in settings.ladders
    failed = sum(attempt.partly for attempt in same) if again else len(same)
    return ladder[min(failed, len(ladder) - 1)]


def _once(condition: str, settings: RecoverySettings) -> bool:
    return condition in ONCE_WELL and condition not in settings.ladders


def _hopeless(fault: Fault, ladder: tuple[str, ...], settings: RecoverySettings, start_s: float) -> str:
    """Why nothing that PHM knows can help; empty: something may."""
    condition = fault.result.condition
    if not ladder:
        return f"no action is known for {condition or 'this'}"
    least_s = start_s + ONCE_WELL_S if fault.life_seen else FOUND_WELL_S
    never_well = fault.result.values.get(NEVER_WELL, fault.well_in_life_s < least_s)
    if _once(condition, settings) and never_well:
        return "it was not well before in this life of its container, so a restart would bring it back"
    return ""


def _in_vain(attempts: int) -> str:
    return "one attempt did not help" if attempts == 1 else f"{attempts} attempts did not help"


def _same_failures(history: History, fault: Fault, now: float, lasting_s: float) -> list[Attempt]:
    """Attempts for the same unit and condition that did not help, since the last one that did or a clean time.

    Help that did not last `lasting_s` was none: a container that starts and dies again counts as failing. Whatever has
    made the unit well for longer, an operator after PHM gave up, starts the count anew. Excused attempts are neither.
    """
    failures: list[Attempt] = []
    broke_again = fault.opened.mono
    for attempt in reversed(history.within(now - CLEAN_S)):
        if (attempt.unit, attempt.condition) != (fault.unit, fault.result.condition):
            continue
        if fault.well_s > lasting_s and attempt.at < fault.opened.mono:
            break
        if attempt.worked and broke_again - attempt.at > lasting_s:
            break
        if attempt.excused:
            continue
        failures.append(attempt)
        broke_again = attempt.at
    return failures


def _ready_at(history: History, fault: Fault, now: float, settings: RecoverySettings) -> float:
    """Back-off: the first attempt at once, then 1, 2, 4 ... seconds after the last, whether it helped or not.

    What helped and broke again so soon counts too, or a flapping container would be restarted without pause; what was
    eased since does not.
    """
    same = [
        attempt
        for attempt in history.within(now - CLEAN_S)
        if (attempt.unit, attempt.condition) == (fault.unit, fault.result.condition) and not attempt.eased
    ]
    if not same:
        return now
    return same[-1].at + float(min(settings.backoff * 2.0 ** (len(same) - 1), settings.backoff_max))
