"""Holds in the running daemon: requested by an operator, or begun by a manual stop or pause, or a maintenance window.

Each change is published. During a hold the tracker publishes bad results as STALE, and recovery does not act.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phm.checking.pipeline import Pipeline
from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Event, HoldChanged, Stamp
from phm.core.settings import ContainerSettings, RecoverySettings
from phm.facts import COMPLETE, CannotTell, ContainerFact, EventStreamFact
from phm.recovery.holds.awaited_events import AwaitedEvents
from phm.recovery.holds.flight_rules import FlightRules
from phm.recovery.holds.hold_registry import ALL, MAX_TEXT, OPERATOR, STOP, WINDOW, Hold, HoldRegistry
from phm.recovery.holds.maintenance_windows import MaintenanceWindows
from phm.recovery.holds.manual_stop import ManualStopDetector, StopVerdict
from phm.recovery.safety.armed_state import ArmedStatus
from phm.recovery.safety.namespaces import Inspect
from phm.wire.report import iso
from phm.wire.text import one_line

logger = logging.getLogger(__name__)

ENDINGS = frozenset({"exited", "oom", "ended", "missing", "not_started", "created"})
"""Conditions of a container that may be part of a restart or a recreation."""
WAITING = "being stopped by an operator; PHM waits to see whether it is started again or recreated"
ARMED_S = 1.0
"""While there is a hold or a window, the armed state is checked this often."""
WINDOWS_S, LABELS_S = 5.0, 30.0
"""Maintenance windows, and the labels that define some, are checked this often."""
SLOW_S = 1.0
"""An engine that takes longer for an answer is asked for the other containers later: a hung one takes the full deadline for each."""
_DONE = {StopVerdict.STOPPED: "stopped", StopVerdict.REMOVED: "removed"}
_OVER = {"start": "it was started again", "unpause": "it was unpaused", "die": "it has ended"}
"""By event: why a stop or a pause by hand is over. A container that ends was paused, or runs: how it has ended decides from then on."""


def _no_engine(ref: str) -> Mapping[str, Any]:
    raise CannotTell("no engine is watched")


class HoldRefused(Exception):
    """The hold or release is refused; the message says why and what is allowed."""


@dataclass(frozen=True)
class HoldInputs:
    """Dependencies of the hold service.

    armed:     the vehicle's armed state; unknown counts as in the air.
    container: the engine's current view of a configured container, for its label. Raises CannotTell.
    stream:    the engine's event stream.
    inspect:   the engine's data of any container (`phm.recovery.safety.namespaces`).
    own:       whether PHM may be ending or starting a container: an action has requested that, or a call to start it
               got no response.
    """

    armed: Callable[[], ArmedStatus]
    container: Callable[[str], ContainerFact | None]
    own: Callable[[str], bool]
    stream: Callable[[], EventStreamFact] = lambda: COMPLETE
    inspect: Inspect = _no_engine


class HoldService:
    """Thread-safe; `start` applies what was restored and starts the thread."""

    def __init__(
        self,
        rules: RecoverySettings,
        containers: Sequence[ContainerSettings],
        holds: HoldRegistry,
        pipeline: Pipeline,
        publish: Callable[[Event], None],
        clock: Clock,
        world: HoldInputs,
    ) -> None:
        self._rules, self._holds, self._pipeline = rules, holds, pipeline
        self._publish, self._clock, self._world = publish, clock, world
        self._keys = tuple(entry.key for entry in containers)
        self._stops = ManualStopDetector()
        self._windows = MaintenanceWindows(rules.maintenance, holds, lambda text: pipeline.note("HOLD", text))
        self._awaited = AwaitedEvents(world.stream)
        holds.explained_until = self._awaited.until
        self._was_armed: bool | None = None
        self._windows_at = self._labels_due = float("-inf")
        self._labels: dict[str, str] = {}
        self._unasked: list[str] = []
        """Containers whose labels are checked next, before those of all again."""
        self._facts: dict[str, ContainerFact] = {}
        """The newest data of each container, also of a removed one: containers in its namespaces depend on it."""
        self._flight = FlightRules(containers, world.armed, self._facts, world.inspect)
        self._seen: set[str] = set()
        self._lock = threading.RLock()
        self._wake, self._stopping = threading.Event(), False
        self._thread = threading.Thread(target=self._loop, name="phm-holds", daemon=True)

    def start(self) -> None:
        now = self._clock.stamp()
        for hold in self._holds.all():
            self._pipeline.note("HOLD", f"{_name(hold)} is {hold.words(now)}, as before PHM was restarted")
        self._apply(self._keys)
        threads.start(self._thread)

    def close(self) -> None:
        self._stopping = True
        self._wake.set()

    # ------------------------------------------------------------ the operator

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]:
        """Begin or replace an operator's hold; container ALL: all. Returns what was done, as text and as data. Raises
        HoldRefused."""
        self._known(container)
        length_s = self._rules.hold if for_s is None else for_s
        if not 1.0 <= length_s <= self._rules.hold_max:
            raise HoldRefused(f"a hold lasts 1 s to {self._rules.hold_max:g} s (recovery.hold_max), not {length_s:g} s")
        keys = [key for key in self._keys if container in (ALL, key)]
        refusal = self._flight.refusal(keys)
        if refusal:
            raise HoldRefused(f"{container or 'a container'} {refusal}")
        unsure = self._flight.warning(keys)
        now = self._clock.stamp()
        hold = Hold(container, OPERATOR, now.mono + length_s, by, one_line(reason)[:MAX_TEXT])
        with self._lock:
            self._begin(hold)  # first, so that an action that begins from now on finds it
            at_work = sorted(
                f"{action} of {key}" for key in self._of(hold) if (action := self._pipeline.action_on(key))
            )
        finishing = f"; PHM first finishes the current action: {', '.join(at_work)}" if at_work else ""
        return f"{_name(hold)} is {hold.words(now)}{finishing}{unsure}", self._json(hold)

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]:
        """End the holds of a container; ALL: every hold. Raises HoldRefused."""
        self._known(container)
        with self._lock:
            ending = [hold for hold in self._holds.all() if container in (ALL, hold.target)]
            if not ending:
                of_all = "; all containers are on hold: `phm release`" if self._holds.all() and container else ""
                raise HoldRefused(f"{container or 'nothing'} is not on hold{of_all}")
            self._end(ending, f"released by {by}")
        names = ", ".join(sorted({_name(hold) for hold in ending}))
        return f"released: {names}", {"released": [self._json(hold) for hold in ending]}

    def snapshot(self) -> list[dict[str, Any]]:
        """The holds for `phm status`, as JSON values."""
        return [self._json(hold) for hold in sorted(self._holds.all(), key=lambda hold: hold.target)]

    def undecided(self) -> dict[str, float]:
        """By container that an operator may be stopping: in how many seconds that is decided. Another PHM would take it for a crash."""
        with self._lock:
            now = self._clock.mono()
            due = {key: self._stops.undecided_until(key, now) for key in self._keys}
        return {key: max(0.0, until - now) for key, until in due.items() if until is not None}

    # ------------------------------------------------------------ the engine's events

    def happened(self, container: str, action: str, detail: str, container_id: str = "") -> None:
        """An event of a configured container, before a check runs for it; actions as in `phm.probes.docker_event`."""
        with self._lock:
            now, own = self._clock.mono(), self._world.own(container)
            late = own and not self._pipeline.action_on(container)
            missed = self._awaited.kill_missed(now)
            self._awaited.note(container, action)
            self._stops.event(
                container, action, detail, now, own=own, late=late, missed=missed, container_id=container_id
            )
            self._end_by_hand(container, _OVER.get(action, ""))
            if action == "pause" and not own and self._holds.on(container, now) is None:
                # Only a person or a tool pauses a container, so there is nothing to wait for.
                self._apply_stop_rule(container, "paused")
            self._apply([container])
        self._wake.set()

    def tick(self) -> float | None:
        """Apply due changes. Returns the seconds until the next call; None: until an event."""
        self._check_labels()
        now = self._clock.mono()
        replaced = self._not_stopped(now)
        with self._lock:
            for key, verdict in self._stops.due(now):
                self._stopped(key, StopVerdict.CRASHED if key in replaced else verdict)
            self._end([hold for hold in self._holds.all() if now >= hold.until], "it has expired")
            self._end_on_arming()
            windows = self._check_windows(self._clock.stamp())
            dues = [hold.until - now for hold in self._holds.all()]
            stop_due = self._stops.next_due()
            dues += [stop_due - now] if stop_due is not None else []
            dues += [ARMED_S] if self._holds.all() else []
            dues += [WINDOWS_S] if windows else []
        return max(0.0, min(dues)) if dues else None

    # ------------------------------------------------------------ inside

    def _loop(self) -> None:
        while not self._stopping:
            self._wake.clear()
            try:
                wait_s = self.tick()
            except Exception:  # a defect here must not prevent a hold from ending
                logger.exception("holds could not be checked")
                wait_s = 1.0
            self._clock.wait(self._wake, wait_s)

    def _begin(self, hold: Hold) -> None:
        now = self._clock.stamp()
        self._holds.put(hold)
        self._apply(self._of(hold))
        self._publish(_on_hold(hold.target, hold, now, f"{_name(hold)} is {hold.words(now)}"))
        self._wake.set()

    def _end(self, ending: Iterable[Hold], why: str, *, for_good: bool = True) -> None:
        """for_good: windows that are still open do not begin their holds again."""
        ended = list(ending)
        self._holds.remove(ended)
        now = self._clock.stamp()
        for hold in ended:
            if for_good and hold.source == WINDOW:
                self._holds.finish(hold.target, hold.occurrence)
            for key in self._of(hold):
                if self._holds.on(key, now.mono) is None:
                    # Results from during the hold do not count, also if the container is being stopped now.
                    self._pipeline.end_hold(key)
            self._apply(self._of(hold))
            self._publish_end(hold, f"{_name(hold)}: the hold by {hold.by} is over: {why}", now)

    def _publish_end(self, ended: Hold, text: str, now: Stamp) -> None:
        """Another hold may still apply to its target, or to a container of ALL: the newest line about that says so."""
        left = self._holds.on(ended.target, now.mono)
        if left is not None:
            text = f"{text}; {_name(ended)} is still {left.words(now)}"
            self._publish(_on_hold(ended.target, left, now, text))
            return
        left_s = max(0.0, ended.until - now.mono)
        self._publish(HoldChanged(now, ended.target, False, ended.by, ended.reason, left_s, text))
        for target in sorted({hold.target for hold in self._holds.all() if ended.covers(hold.target)}):
            left = self._holds.on(target, now.mono)
            if left is not None:
                self._publish(_on_hold(target, left, now, f"{target} is still {left.words(now)}"))

    def _apply(self, keys: Iterable[str]) -> None:
        """Apply the state of these containers to the tracker."""
        now = self._clock.stamp()
        undecided = self._stops.undecided()
        for key in keys:
            self._holds.set_undecided(key, self._stops.undecided_until(key, now.mono))
            hold = self._holds.on(key, now.mono)
            if hold is not None:
                self._pipeline.put_on_hold(key, hold.words(now))
            elif key in undecided:
                self._pipeline.put_on_hold(key, WAITING, ENDINGS)
            else:
                self._pipeline.end_hold(key)

    def _end_by_hand(self, key: str, why: str) -> None:
        """A stop or a pause by hand is over, and so is its hold. why: empty: it is not over."""
        if why:
            self._holds.mark_stopped(key, False)
            self._end([hold for hold in self._of_source(STOP) if hold.target == key], why)

    def _stopped(self, key: str, verdict: StopVerdict) -> None:
        if verdict is not StopVerdict.CRASHED and self._holds.on(key, self._clock.mono()) is None:
            self._apply_stop_rule(key, _DONE[verdict])
        self._apply([key])

    def _not_stopped(self, now: float) -> frozenset[str]:
        """Containers that are about to count as stopped, but run: started, or replaced by another one.

        Events may be lost, and a container may be removed after a copy has replaced it. Called without the lock, like
        `_check_labels`.
        """
        with self._lock:
            ripe = self._stops.nearly_due(now)
        found = set()
        for key, ended in ripe.items():
            try:
                fact = self._world.container(key)
            except CannotTell:
                if self._clock.mono() - now > SLOW_S:
                    break
                continue
            if fact is not None and (fact.running or (ended and fact.id != ended)):
                found.add(key)
        return frozenset(found)

    def _apply_stop_rule(self, key: str, done: str) -> None:
        rule = self._rules.on_manual_stop.air if self._world.armed().restricts else self._rules.on_manual_stop.ground
        if rule == "respect" and not (self._flight.armed and self._flight.critical([key])):
            until = self._clock.mono() + self._rules.hold
            self._begin(Hold(key, STOP, until, "an operator", f"{done} by hand"))
            return
        advise = rule != "heal"
        self._holds.mark_stopped(key, advise)
        what = "PHM only recommends an action" if advise else "PHM treats it as a failure"
        self._pipeline.note("HOLD", f"{key} was {done} manually; {what} (recovery.on_manual_stop)")

    def _end_on_arming(self) -> None:
        """End holds begun on the ground when the vehicle is armed, except an operator's hold of a container that is not
        flight-critical. It may have been armed while PHM restarted; only a respected stop can have begun since."""
        armed, first = self._flight.armed, self._was_armed is None
        was_armed = self._holds.armed_before if first else self._was_armed
        if armed and (first or not was_armed):
            ending = [
                hold
                for hold in self._holds.all()
                if hold.source == WINDOW
                or self._flight.critical(self._of(hold))
                or (hold.source == STOP and not was_armed)
            ]
            self._end(ending, "the autopilot is armed")
        self._was_armed = armed

    def _check_labels(self) -> None:
        """Called without the lock: a hung engine must not block others."""
        now = self._clock.mono()
        if now < self._labels_due:
            return
        self._labels_due = now + LABELS_S
        # The event of a start may have been lost. Only for containers stopped before the request: the response may be older than a stop.
        stopped = {hold.target for hold in self._of_source(STOP)} | set(self._holds.stops())
        self._unasked = self._unasked or list(self._keys)
        while self._unasked:
            key = self._unasked.pop(0)
            answered = self._check_label(key, key in stopped)
            slow = self._clock.mono() - now > SLOW_S
            if slow and not answered:
                return
            if slow and self._unasked:
                self._labels_due = now + WINDOWS_S
                return
        self._flight.observe()

    def _check_label(self, key: str, stopped: bool) -> bool:
        """stopped: by hand, as far as PHM knows. Returns whether the engine answered."""
        try:
            fact = self._world.container(key)
        except CannotTell:
            return False
        self._labels[key] = fact.maintenance if fact is not None else ""
        if fact is not None:
            self._facts[key] = fact
        if fact is not None and fact.running:
            self._awaited.found_running(key)
            if key not in self._seen or stopped:
                with self._lock:  # perhaps it was started while PHM was not running
                    self._end_by_hand(key, _OVER["start"])
        elif key not in self._seen:
            self._awaited.found_ended(key)
        self._seen.add(key)
        return True

    def _check_windows(self, now: Stamp) -> bool:
        """Begin and end the holds of maintenance windows. Returns whether there may be any windows."""
        if now.mono - self._windows_at >= WINDOWS_S and not self._was_armed:
            self._windows_at = now.mono
            begun = set()
            for hold in self._windows.due(now, self._labels):
                if not (self._world.armed().restricts and self._flight.critical(self._of(hold))):
                    self._begin(hold)
                    begun.add(hold.target)
            # Last, so that recovery does not act before a window that was only changed is open again.
            removed = self._windows.removed()
            for what, changed in (("no longer has it", False), ("has changed it", True)):
                ending = [hold for hold in removed if (hold.target in begun) is changed]
                self._end(ending, f"the configuration {what}", for_good=False)
        return bool(self._rules.maintenance or self._keys)

    def _of(self, hold: Hold) -> tuple[str, ...]:
        return tuple(key for key in self._keys if hold.covers(key))

    def _of_source(self, source: str) -> list[Hold]:
        return [hold for hold in self._holds.all() if hold.source == source]

    def _known(self, container: str) -> None:
        if container and container not in self._keys:
            raise HoldRefused(
                f"there is no container {container!r} in the configuration: {', '.join(self._keys) or 'it has none'}"
            )

    def _json(self, hold: Hold) -> dict[str, Any]:
        now = self._clock.stamp()
        left_s = max(0.0, hold.until - now.mono)
        return {
            "container": hold.target or None,
            "source": hold.source,
            "by": hold.by,
            "reason": hold.reason,
            "until": iso(now.utc + left_s),
            "left_s": round(left_s, 1),
        }


def _on_hold(target: str, hold: Hold, now: Stamp, text: str) -> HoldChanged:
    return HoldChanged(now, target, True, hold.by, hold.reason, hold.until - now.mono, text)


def _name(hold: Hold) -> str:
    return hold.target or "every container"
