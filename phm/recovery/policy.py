"""Decides what to do about a fault. Pure: fault, history and limits in, a decision out.

The first rule that matches decides:

1. No ladder for the condition, or no step of it applies: skip.
2. A condition that only a restart after a good start can help, and the unit was never OK in this generation: skip.
3. Recovery is off, the target is not configured or has not opted in: skip.
4. The container is on hold: wait for its end. Not decided whether an operator is stopping it: wait for that.
5. Starvation explains the condition: wait until it is over.
6. The same failure `same_failure` times, or as many failures of an action on the entire container: give up.
7. `patience_s` is not over: wait.
8. Forbidden while armed, stopped by an operator, a condition that is only advised, or mode advise: advise.
9. Budget used up, or back-off not over: wait.
10. Else the step of the ladder that follows the number of failed attempts.

Actions on PHM's own container and links are limited by rules 1, 6, 7 and 9 only.
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
    "quorum_dead": ("restart",),
    "silent": ("relaunch", "restart"),
    "rate_low": ("relaunch", "restart"),
    "publisher_lost": ("restart",),
    "subscriber_lost": ("restart",),
    "qos_mismatch": ("restart",),
    "node_duplicate": ("restart",),
    "not_ready": ("restart",),
    "transport_blocked": ("restart",),
    "data_frozen": ("restart",),
    "data_stamp": ("restart",),
    "data_gaps": ("restart",),
    "data_range": ("restart",),
    "file_missing": ("restore_file",),
    "file_not_executable": ("restore_file",),
    "file_altered": ("restore_file",),
    "device_replugged": ("restart",),
    "link_silent": ("reopen",),
    "radio_silent": ("reopen",),
    "autopilot_silent": ("reopen",),
    "disk_full": ("free_disk",),
    "cpu_starved": ("relieve",),
    "custom_failed": ("restart",),
}
"""Built-in ladders by condition. Conditions that are not listed are only reported: `restarting` because the engine's
own restart policy is at work, `dead` because the engine refuses to restart what it could not remove,
`not_received` because a restart does not open a transport that was never open."""
_DATA = frozenset({"data_frozen", "data_stamp", "data_gaps", "data_range"})
_TOPIC = frozenset({"silent", "rate_low", "publisher_lost", "subscriber_lost", "qos_mismatch"}) | _DATA
PATIENT = _TOPIC | {"node_duplicate", "not_ready"}
"""Conditions that must have lasted `recovery.patience`: a source that pauses does not yet hang, and a node may
create its endpoints again by itself, be activated again, or be replaced by a copy that starts before it ends."""
LEARNED = _TOPIC
"""Of these, the ones whose pauses PHM knows after a while: see `patience_s`. A second node is started by someone, at any time."""
PAUSES = 2.0
"""PHM waits this many times the longest pause after which a topic came back."""
DOWN = frozenset({"exited", "oom", "created"})
"""Conditions of a container that does not run. A start makes nothing worse as long as its dependents are not restarted, so it
is tried for as long as the container is down: a part of the budget is reserved for it, and when that is used up, or recovery
has given up, it is tried once per `recovery.backoff_max`."""
GENTLE = frozenset({"relieve"})
"""Actions that disturb no container: limited by back-off only, they use up no budget."""
OUTSIDE = frozenset({"network_missing"})
"""Conditions that come from outside of every container: no action on a container causes them."""
AGAIN_WHILE_IT_LASTS = frozenset({"disconnected"})
"""Conditions that only the first step of the ladder can end: a restart connects nothing. The next step is for what needs the unit
and has not recovered although the unit itself has."""
ADVISED = frozenset({"data_gaps", "data_range"})
"""Conditions for which the built-in ladder is only advised: the messages arrive and most of them are usable, and whether a restart
helps depends on the sensor or input behind the node. A user's own ladder is carried out."""
ONCE_WELL = frozenset(
    {"transport_blocked", "qos_mismatch", "node_duplicate", "quorum_dead", "data_frozen", "data_stamp", "not_ready"}
)
"""Conditions that a restart ends only where the container's own start is not their cause: firewall rules of its network
namespace, a publisher that was created again, a second node started by an operator, a node that its neighbours no longer
receive, a source that repeats old data, a wrong clock on another computer, a node that was deactivated.
Where the unit was OK in this generation,
a restart restores what the start had, and is tried once; where it never was, nothing is done. A user's own ladder is used
unchanged."""
ONCE_WELL_S, FOUND_WELL_S = 2.0, 5.0
"""Seconds for which a unit must have been reported OK to count as OK in this generation: beyond the grace of the start, in which
parts come up and names of the previous generation disappear; and where the container started before PHM did. A check that
knows better says so (`phm.core.model.Evidence.never_ok`)."""


@dataclass(frozen=True, slots=True)
class Act:
    """Carry out the action."""

    action: str
    attempt: int


@dataclass(frozen=True, slots=True)
class Advise:
    """Report what would help; do nothing. again_at: when to decide again (monotonic seconds); None: final for this fault."""

    action: str
    why: str
    again_at: float | None = None


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing until then (monotonic seconds). report: whether it is published, once for each `subject`."""

    until: float
    why: str
    report: bool = False
    subject: str = "wait"


@dataclass(frozen=True, slots=True)
class GiveUp:
    """Escalate to the operator. action: what would be next."""

    action: str
    why: str


@dataclass(frozen=True, slots=True)
class Skip:
    """There is nothing that PHM may or can do."""

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
    approved: an operator has approved this action: mode advise and the armed state do not apply.
    unrestricted: actions on PHM's own container and links: mode, opt-in and the armed state do not apply to them.
    usable: the actions that apply to this fault; other steps are left out. None: all.
    hold: until when (monotonic seconds) the container is on hold, and why; None: it is not.
    undecided: when it is decided whether an operator is stopping the container (monotonic seconds); None: it is decided.
    stopped_by_hand: an operator stopped the container, and then PHM only advises (`recovery.on_manual_stop`).
    start_s: how long the parts of a container may take to start (`ros.grace`).
    container_wide: actions on the entire container: one that did not help one fault is not repeated for another.
    starved: the pressure unit that explains the condition; empty: none does.
    given_up: recovery has given up on the fault, and its container is down: only the first step is tried, once per `backoff_max`.
    """
    condition = fault.result.condition
    ladder = tuple(step for step in ladder_of(condition, settings) if usable is None or step in usable)
    hopeless = _hopeless(fault, ladder, settings, start_s)
    if hopeless:
        return Skip(hopeless)
    if given_up and START not in ladder:
        return Skip("only a start is tried again after recovery has given up")
    failures = Failures(history, fault, now, settings.verify)
    same = failures.of_the_unit()
    action = START if given_up else _step(ladder, condition, same, settings)
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
    wait_s = patience_s(fault, settings)
    if wait_s and now < fault.opened.mono + wait_s:
        return Wait(fault.opened.mono + wait_s, "it may come back by itself")
    bound = action not in unrestricted and not approved
    forbidden = forbids(action) if bound else ""
    if forbidden:
        return Advise(action, forbidden, again_at=now + ARMED_AGAIN_S)
    advised = _only_advised(condition, settings, stopped_by_hand=stopped_by_hand) if bound else ""
    if advised:
        return Advise(action, advised)
    act = Act(action, len(same) + 1)
    return _when(act, failures, elsewhere, settings, given_up=given_up, free=action in unrestricted)


def _only_advised(condition: str, settings: RecoverySettings, *, stopped_by_hand: bool) -> str:
    """Why the action is only recommended; empty: it is carried out."""
    if stopped_by_hand:
        return "it was stopped by hand, recovery.on_manual_stop is advise"
    if condition in ADVISED and condition not in settings.ladders:
        return "the topic still has data, and the cause may be outside of the container"
    return "recovery only advises" if settings.mode == "advise" else ""


def patience_s(fault: Fault, settings: RecoverySettings) -> float:
    """For how many seconds the fault must have lasted before an action: a source may pause.

    A topic that was OK for `verify` since its container started has shown how long its pauses are.
    """
    condition = fault.result.condition
    if condition not in PATIENT:
        return 0.0
    if condition not in LEARNED or fault.ok_since_start_s < settings.verify:
        return settings.patience
    return min(settings.patience, max(settings.patience_min, PAUSES * fault.pause_s))


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


def _step(ladder: tuple[str, ...], condition: str, same: list[AttemptRecord], settings: RecoverySettings) -> str:
    """The step that follows this many failed attempts."""
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
        return "it was never OK since its container started, so a restart would not help"
    return ""


def _in_vain_elsewhere(action: str, attempts: int, unit: str) -> str:
    times = "once" if attempts == 1 else f"{attempts} times"
    return f"{action} has not helped {times} on this container, and is not repeated for {unit}"


def _in_vain(attempts: int) -> str:
    return "one attempt did not help" if attempts == 1 else f"{attempts} attempts did not help"
