"""Holds: until when recovery does not act on a container on request, who requested it and why. Pure.

A hold always has an end, on the monotonic clock: setting the clock neither extends nor ends it. A restart of PHM on the
same boot does not change that end; after a reboot, the time that was left when it was last written counts again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from phm.core.model import Stamp
from phm.wire.report import iso

ALL = ""
"""The target of a hold on all containers."""
OPERATOR, STOP, WINDOW = "operator", "stop", "window"
"""The source of a hold: `phm hold`, a container that an operator stopped or paused, a maintenance window."""
LONGEST_S = 24 * 3600.0
KEPT_EVERY_S = 30.0
"""The time left of a hold is written this often: a reboot extends the hold by no more than that and the time the machine was off."""
LATE_S = 10.0
"""A verdict on a stop that is this long overdue is not waited for: a defect must not block recovery permanently."""
BEING_STOPPED = "being stopped or replaced by an operator"
MAX_HOLDS = 64
MAX_DONE = 256
MAX_TEXT = 200


@dataclass(frozen=True, slots=True)
class Hold:
    """target: key of the container, or ALL. until: monotonic seconds. occurrence: of a maintenance window: its begin and end."""

    target: str
    source: str
    until: float
    by: str
    reason: str = ""
    occurrence: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        """Another hold with this key replaces it."""
        return self.target, self.source, self.occurrence

    def covers(self, target: str) -> bool:
        return self.target in (ALL, target)

    def words(self, now: Stamp) -> str:
        """``on hold until 12:34:05 UTC by operator (uid 0): swapping firmware``."""
        until = iso(now.utc + self.until - now.mono)
        date = "" if until[:10] == iso(now.utc)[:10] else f"{until[:10]} "
        reason = f": {self.reason}" if self.reason else ""
        return f"on hold until {date}{until[11:19]} UTC by {self.by}{reason}"


@dataclass(frozen=True, slots=True)
class PersistedHold:
    """For the state file. left_s: the time left, rounded up to KEPT_EVERY_S so that the file does not change each time."""

    hold: Hold
    left_s: float


@dataclass(frozen=True, slots=True)
class HoldStatus:
    """What keeps recovery from one target on request.

    hold:            the one that ends last; None: it is not on hold.
    undecided:       when it is decided whether an operator stopped it (monotonic seconds); None: it is decided.
    stopped_by_hand: an operator stopped or paused it, and PHM only advises then (`recovery.on_manual_stop`).
    """

    hold: Hold | None = None
    undecided: float | None = None
    stopped_by_hand: bool = False

    def words(self, now: Stamp) -> str:
        """Why nothing may be done to the target, as part of a sentence; empty: something may."""
        if self.hold is not None:
            return self.hold.words(now)
        return BEING_STOPPED if self.undecided is not None else ""


NOTHING_REQUESTED = HoldStatus()


class HoldRegistry:
    """All holds, at most one for each target and source, and of windows for each occurrence: windows that overlap are all in
    force. Thread-safe; `changed` is called after each change."""

    def __init__(self) -> None:
        self._of: dict[tuple[str, str, str], Hold] = {}
        self._by_hand: set[str] = set()
        self._undecided: dict[str, float] = {}
        self._done: dict[tuple[str, str], None] = {}
        self.concerned: frozenset[str] = frozenset()
        """Targets, or ALL, of which anything is known here. The set is replaced and never changed: any thread may read it."""
        self.armed_before = False
        """Whether the vehicle was armed as far as the previous PHM knew: what was on hold then may stay so."""
        self.explained_until: Callable[[str, float, bool], float | None] = lambda target, now, paused: None
        """Until when an event may arrive that explains why the target has exited, or is paused (monotonic seconds); None: none is
        expected."""
        self._lock = threading.Lock()
        self.changed: Callable[[], None] = lambda: None

    def put(self, hold: Hold) -> None:
        """Begin the hold, or replace the one with its key."""
        with self._lock:
            self._of[hold.key] = hold
            while len(self._of) > MAX_HOLDS:
                del self._of[min(self._of, key=lambda key: self._of[key].until)]
            self._update_concerned()
        self.changed()

    def remove(self, holds: Iterable[Hold]) -> None:
        with self._lock:
            for hold in holds:
                if self._of.get(hold.key) == hold:
                    del self._of[hold.key]
            self._update_concerned()
        self.changed()

    def all(self) -> tuple[Hold, ...]:
        with self._lock:
            return tuple(self._of.values())

    def on(self, target: str, now: float) -> Hold | None:
        """The hold that keeps recovery from the target at `now` (monotonic seconds): the one that ends last."""
        found = [hold for hold in self.all() if hold.covers(target) and hold.until > now]
        return max(found, key=lambda hold: hold.until, default=None)

    def stopped_by_hand(self, target: str) -> bool:
        """Whether an operator stopped or paused it and PHM only advises then."""
        return target in self._by_hand

    def mark_stopped(self, target: str, stopped: bool) -> None:
        with self._lock:
            (self._by_hand.add if stopped else self._by_hand.discard)(target)
            self._update_concerned()

    def set_undecided(self, target: str, until: float | None) -> None:
        """Until when (monotonic seconds) it is decided whether an operator stopped it; None: that is decided."""
        with self._lock:
            before = self._undecided.get(target)
            if until is None:
                self._undecided.pop(target, None)
            else:
                self._undecided[target] = until
            self._update_concerned()
        if before != until:
            self.changed()

    def undecided(self, target: str, now: float, *, ended: bool = False, paused: bool = False) -> float | None:
        """When it is decided whether an operator stopped or paused the target (monotonic seconds); None: it is decided.

        ended, paused: its container has exited, or is paused, and the decision is about that.
        """
        until = self._undecided.get(target)
        if until is None or now >= until + LATE_S:
            return self.explained_until(target, now, paused) if ended or paused else None
        return max(until, now)

    def status(self, target: str, now: float, *, ended: bool = False, paused: bool = False) -> HoldStatus:
        """All of it at `now` (monotonic seconds). ended, paused: as of `undecided`."""
        undecided = self.undecided(target, now, ended=ended, paused=paused)
        return HoldStatus(self.on(target, now), undecided, self.stopped_by_hand(target))

    def why_not_start(self, target: str, now: Stamp) -> str:
        """Why the target must not be restarted as a dependent; empty: it may be."""
        status = self.status(target, now.mono)
        return status.words(now) or ("paused or stopped by hand" if status.stopped_by_hand else "")

    def _update_concerned(self) -> None:
        self.concerned = frozenset({hold.target for hold in self._of.values()} | self._by_hand | self._undecided.keys())

    # ------------------------------------------------------------ over a restart of PHM

    def stops(self) -> tuple[str, ...]:
        """For the state file: what `mark_stopped` has marked."""
        return tuple(sorted(self._by_hand))

    def finish(self, target: str, occurrence: str) -> None:
        """An occurrence of a maintenance window is over or was released: it does not begin again."""
        self._done[target, occurrence] = None
        while len(self._done) > MAX_DONE:
            del self._done[next(iter(self._done))]

    def done(self) -> tuple[tuple[str, str], ...]:
        """For the state file: target and occurrence of each maintenance window that is over, the oldest first."""
        return tuple(self._done)

    def kept(self, now: float) -> tuple[PersistedHold, ...]:
        return tuple(
            PersistedHold(hold, -(-(hold.until - now) // KEPT_EVERY_S) * KEPT_EVERY_S)
            for hold in self.all()
            if hold.until > now
        )

    def restore(
        self,
        kept: Iterable[PersistedHold],
        stops: Iterable[str],
        done: Iterable[tuple[str, str]] = (),
        *,
        armed: bool = False,
    ) -> None:
        """armed: whether the vehicle was armed when the previous PHM stopped."""
        for target in stops:
            self.mark_stopped(target, True)
        self.armed_before = armed
        for target, occurrence in done:
            self.finish(target, occurrence)
        for entry in kept:
            self.put(entry.hold)


def carried(hold: Hold, left_s: float, now: float, *, same_boot: bool) -> Hold:
    """The hold of an earlier PHM with its end on the monotonic clock of now: never later than it was to be."""
    left_s = min(max(left_s, 0.0), LONGEST_S)
    return replace(hold, until=min(hold.until, now + left_s) if same_boot else now + left_s)
