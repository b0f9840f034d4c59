"""Decides what to do about a fault. Pure: fault, history and what is forbidden in, a decision out.

Rules, first match wins: no ladder for the condition -> nothing; never well in this life of its container, where
only that gives hope -> nothing; mode off -> nothing; not opted in ->
nothing; on hold -> wait until its end; a symptom of
starvation -> wait until that is over; not decided yet whether it is being stopped by hand -> wait for that;
the same failure `same_failure` times, or an action on the whole container that did not help it so often for any of its faults ->
give up and say so; forbidden while armed
-> advise; stopped by hand where that is only advised about -> advise; mode
advise -> advise; budget used up -> wait, and say so; back-off not over -> wait; else the rung of the ladder that
follows the number of failed attempts. Actions on PHM's own container and links are bound by budget and back-off alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from phm.core.model import Fault
from phm.core.settings import RecoverySettings
from phm.recovery.history import AttemptRecord, Failures, History
from phm.recovery.holds.hold_registry import BEING_STOPPED
from phm.recovery.target import Target

HOLD, STARVED, START = "hold", "starved", "start"
LADDERS: Mapping[str, tuple[str, ...]] = {
    "exited": ("start", "restart"),
    "oom": ("start", "restart"),
    "created": ("start",),
    "paused": ("unpause", "restart"),
    "unhealthy": ("restart",),
    "disconnected": ("reconnect", "restart"),
    "address_silent": ("reconnect", "restart"),
    "sidecar_disconnected": ("join_network",),
    "node_missing": ("relaunch", "restart"),
    "node_hung": ("restart",),
    "silent": ("relaunch", "restart"),
    "rate_low": ("relaunch", "restart"),
    "publisher_lost": ("restart",),
    "subscriber_lost": ("restart",),
    "qos_mismatch": ("restart",),
    "node_duplicate": ("restart",),
    "transport_blocked": ("restart",),
    "file_missing": ("restore_file",),
    "file_not_executable": ("restore_file",),
    "file_altered": ("restore_file",),
    "device_replugged": ("restart",),
    "link_silent": ("reopen",),
    "radio_silent": ("reopen",),
    "autopilot_silent": ("reopen",),
    "disk_full": ("free_disk",),
    "cpu_starved": ("relieve",),
}
"""Built-in ladders by condition. Conditions that are not here are told and left alone: `restarting` because the engine's
own restart policy is at work and is not fought, `dead` because the engine refuses to restart what it could not remove,
`not_received` because a transport that was never open outlives every restart."""
PATIENT = frozenset({"silent", "rate_low", "publisher_lost", "subscriber_lost", "qos_mismatch", "node_duplicate"})
"""Conditions that must have lasted `recovery.patience`: a source that pauses is not yet one that hangs, and a node may make
its ends anew by itself, or be relieved by a copy that starts before it ends."""
DOWN = frozenset({"exited", "oom", "created"})
"""Conditions of a container that does not run. A start makes nothing worse as long as what depends on it is left alone, so it is
tried for as long as the container is down: a part of the budget is reserved for it, and when that is used up, or recovery has
given up, once per `recovery.backoff_max`."""
GENTLE = frozenset({"relieve"})
"""Actions that disturb no container: they are bound by back-off alone, and use up no budget."""
OUTSIDE = frozenset({"network_missing"})
"""Conditions that come from outside of every container. An action after which a unit has one of them is not to blame."""
AGAIN_WHILE_IT_LASTS = frozenset({"disconnected"})
"""Conditions that only the first step of the ladder can end: a restart connects nothing. The next step is for what needs the unit
and has not come back after the unit itself did."""
ONCE_WELL = frozenset({"transport_blocked", "qos_mismatch", "node_duplicate"})
"""Conditions that a restart ends only where the container's own start is not their cause: firewall rules of its network
namespace, a publisher that was made anew, a second node started by hand. Where it was well in this life, a restart brings
back what the start had, and is tried once; where it never was, nothing is done. A ladder of the user's own holds as it is."""
ONCE_WELL_S, FOUND_WELL_S = 2.0, 5.0
"""What has been told well for longer was not wrong from the start: beyond the grace of that start, in which all comes up and names
of the life before go; where the container ran before PHM did, since PHM looks. A check that knows better says so
(`phm.core.model.Evidence.never_ok`)."""


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
    report: bool = False
    subject: str = "wait"


@dataclass(frozen=True, slots=True)
class GiveUp:
    action: str
    why: str


@dataclass(frozen=True, slots=True)
class Skip:
    """Nothing that PHM may or can do."""

    why: str


Decision = Act | Advise | Wait | GiveUp | Skip
ARMED_AGAIN_S = STARVED_AGAIN_S = 2.0


def decide(
    fault: Fault,
    history: History,
    now: float,
    *,
    target: Target,
    forbids: Callable[[str], str],
    settings: RecoverySettings,
    unrestricted: frozenset[str] = frozenset(),
    approved: bool = False,
    usable: frozenset[str] | None = None,
    start_s: float = 8.0,
    hold: tuple[float, str] | None = None,
    undecided: float | None = None,
    stopped_by_hand: bool = False,
    container_wide: frozenset[str] = frozenset(),
    starved: str = "",
    given_up: bool = False,
) -> Decision:
    """What to do about `fault` at `now` (monotonic seconds).

    forbids: why an action must not be done while the vehicle may be armed; empty: it may (`phm.recovery.safety.flight_critical`).
    approved: an operator has approved this action: mode advise and the armed state no longer hold it back.
    free_actions: actions on PHM's own container and links; they endanger nobody, so mode, opt-in and arming do not bind them.
    usable: the actions that apply to this fault; other rungs are left out. None: all.
    hold: until when (monotonic seconds) the container is on hold, and that in words; None: it is not.
    undecided: when it is decided whether an operator is stopping the container (monotonic seconds); None: it is decided.
    stopped_by_hand: an operator stopped the container, and then PHM only advises (`recovery.on_manual_stop`).
    start_s: how long the parts of a container may take to come up (`ros.grace`).
    shared_actions: actions on the container as a whole: one that did not help one of its faults is not repeated for another.
    starved: the pressure unit that explains what is wrong; empty: none does.
    given_up: recovery has given up on the fault, and its container is down: only the first step is tried, once per `backoff_max`.
    """
    condition = fault.result.condition
    ladder = tuple(rung for rung in ladder_of(condition, settings) if usable is None or rung in usable)
    hopeless = _hopeless(fault, ladder, settings, start_s)
    if hopeless:
        return Skip(hopeless)
    if given_up and START not in ladder:
        return Skip("only a start is tried again after recovery has given up")
    failures = Failures(history, fault, now, settings.verify)
    same = failures.of_the_unit()
    action = START if given_up else _rung(ladder, condition, same, settings)
    if action not in unrestricted:
        refused = _refused(target, settings, hold, undecided)
        if refused is not None:
            return refused
        if starved:
            return Wait(
                now + STARVED_AGAIN_S,
                f"{starved} explains it, and a restart would cost more of it",
                report=True,
                subject=STARVED,
            )
    most = 1 if _once(condition, settings) else settings.same_failure
    if not given_up and len(same) >= most:
        goes_on = f", one start every {settings.backoff_max:g} s goes on" if condition in DOWN else ""
        return GiveUp(action, f"{_in_vain(len(same))}{goes_on}")
    elsewhere = failures.of_the_action(action) if action in container_wide and condition not in DOWN else []
    if len(elsewhere) >= most:
        return GiveUp(action, _in_vain_elsewhere(action, len(elsewhere), fault.unit))
    if condition in PATIENT and now < fault.opened.mono + settings.patience:
        return Wait(fault.opened.mono + settings.patience, "it may come back by itself")
    bound = action not in unrestricted and not approved
    forbidden = forbids(action) if bound else ""
    if forbidden:
        return Advise(action, forbidden, again_at=now + ARMED_AGAIN_S)
    if bound and stopped_by_hand:
        return Advise(action, "it was stopped by hand, recovery.on_manual_stop is advise")
    if bound and settings.mode == "advise":
        return Advise(action, "recovery only advises")
    act = Act(action, len(same) + 1)
    return _when(act, failures, elsewhere, settings, given_up=given_up, free=action in unrestricted)


def _refused(
    target: Target,
    settings: RecoverySettings,
    hold: tuple[float, str] | None,
    undecided: float | None,
) -> Skip | Wait | None:
    """Why nothing may be done to the container, whatever is wrong with it."""
    if settings.mode == "off":
        return Skip("recovery is off")
    if not target.configured:
        return Skip("no container to act on")
    if not target.opted_in:
        return Skip(f"{target.name} has not opted in (recover: true)")
    if hold is not None:
        return Wait(hold[0], hold[1], report=True, subject=HOLD)
    return Wait(undecided, BEING_STOPPED) if undecided is not None else None


def _when(
    act: Act,
    failures: Failures,
    elsewhere: Sequence[AttemptRecord],
    settings: RecoverySettings,
    *,
    given_up: bool,
    free: bool,
) -> Act | Wait:
    """The action, or until when budget and back-off hold it back. free: it disturbs no container."""
    now, down = failures.now, failures.fault.result.condition in DOWN
    recent = [made for made in failures.history.within(now - settings.window) if made.action not in GENTLE]
    free = free or act.action in GENTLE
    if act.action in GENTLE:
        recent = []
    most = settings.budget if down or free else max(1, settings.budget - settings.reserve)
    if len(recent) >= most and not down:
        kept = f", {settings.budget - most} kept for a container that is down" if most < settings.budget else ""
        return Wait(recent[-most].at + settings.window, f"budget of {most} actions used up{kept}", report=True)
    if recent and (given_up or len(recent) >= most):
        ready = recent[-1].at + settings.backoff_max
        why = f"budget of {most} actions used up, one attempt every {settings.backoff_max:g} s"
        return Wait(ready, why, report=not given_up) if now < ready else act
    ready = failures.ready_at(settings, elsewhere)
    return Wait(ready, "backing off") if now < ready else act


def ladder_of(condition: str, settings: RecoverySettings) -> tuple[str, ...]:
    """The user's ladder for the condition, else the built-in one, else none."""
    return tuple(settings.ladders.get(condition, LADDERS.get(condition, ())))


def _rung(ladder: tuple[str, ...], condition: str, same: list[AttemptRecord], settings: RecoverySettings) -> str:
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
    least_s = start_s + ONCE_WELL_S if fault.start_seen else FOUND_WELL_S
    known = fault.result.evidence.never_ok
    never_ok = fault.ok_since_start_s < least_s if known is None else known
    if _once(condition, settings) and never_ok:
        return "it was not well before in this life of its container, so a restart would bring it back"
    return ""


def _in_vain_elsewhere(action: str, attempts: int, unit: str) -> str:
    times = "once" if attempts == 1 else f"{attempts} times"
    return f"{action} has not helped {times} on this container, and is not repeated for {unit}"


def _in_vain(attempts: int) -> str:
    return "one attempt did not help" if attempts == 1 else f"{attempts} attempts did not help"
