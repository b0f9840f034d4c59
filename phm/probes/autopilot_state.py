"""The vehicle's autopilot from its heartbeats, and its reboots. Pure.

A reboot shows as the first of
- HEARTBEAT.system_status BOOT (or UNINIT) after another state: what a copter sends until its sensors are ready;
- the time since boot going back, in SYSTEM_TIME, TIMESYNC or another message that contains it, as ArduPilot recommends for
  ground stations. By default ArduPilot sends a companion only TIMESYNC, every 10 s;
- the text "ArduPilot Ready" at the end of its start, for vehicles without the state BOOT.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from phm.core.scheduling_delay import Late, never_late
from phm.facts.links import REBOOT_SILENCE_S, AutopilotFact
from phm.probes.adaptive_timeout import AdaptiveTimeout
from phm.probes.armed_reports import ArmedReports
from phm.transport.dialect import mavlink

BACK_S = 3.0
"""Messages overtake each other, and some contain the time of a measurement and not of sending."""
WRAP_S, WRAPS_AT_S = 60.0, 2**32 / 1000.0
TWINS, TWINS_S = 4, 6.0
"""An autopilot that reboots repeatedly runs for at least BACK_S each time: faster changes mean two senders."""
FLIPS, FLIPS_S = 4, 10.0
"""No operator arms and disarms so often in so short a time: two autopilots contradict each other."""
KEPT = 16
BOOTING = frozenset({mavlink.MAV_STATE_UNINIT, mavlink.MAV_STATE_BOOT})
START_S = 30.0
"""An autopilot starts within this time: other evidence in that time is of the same start, also when a second link delivers it
later, unless a silence or the time since boot shows another one."""
ALIVE_S = 1.0
"""While its other frames arrive, its heartbeats are late or lost, but the autopilot is not lost."""


class AutopilotState:
    """Not thread-safe. timeout_s: silence after which it is lost in any case. late_s: for how long PHM did not run."""

    def __init__(self, timeout_s: float = 3.5, late_s: Late = never_late) -> None:
        self._cadence, self._timeout_s, self._late_s = AdaptiveTimeout(timeout_s), timeout_s, late_s
        self._silent_s = min(timeout_s, REBOOT_SILENCE_S)
        self._said: dict[str, tuple[float, bool]] = {}
        """Per link: time of the last heartbeat, and whether it reported armed."""
        self._reports = ArmedReports(timeout_s)
        self._said_armed: dict[bool, float] = {}
        """When armed (True) and disarmed (False) were last reported, on any link."""
        self._disarmed_from: float | None = None
        """Start of the unbroken series of disarmed heartbeats; None: the newest one reports armed."""
        self._stalled: float | None = None
        self._spoke = float("-inf")
        self._beat: tuple[float, Any, str] | None = None
        self._armed: deque[tuple[float, bool]] = deque(maxlen=KEPT)
        """Changes of the armed state, with the time when they were observed."""
        self._boot: tuple[float, float] | None = None
        """When the newest time since boot was received, and that time in seconds."""
        self._seen: deque[float] = deque(maxlen=TWINS)
        self._booting = False
        """It starts, according to its newest heartbeat, or it rebooted since."""
        self._first: float | None = None
        self._before_pause: float | None = None
        """Its last heartbeat before the newest silence in which it may have rebooted."""
        self._resumed = float("-inf")
        """Its first heartbeat after that silence."""
        self._commanded: float | None = None
        """When it acknowledged a command to reboot."""
        self.reboots = 0
        self._rebooted: float | None = None
        """When the newest evidence of a reboot was received."""
        self._rebooted_armed = False

    @property
    def link(self) -> str:
        """Link of the newest heartbeat; empty: none received."""
        return self._beat[2] if self._beat is not None else ""

    def broke(self, now: float) -> None:
        """Ignore the pause until now: its link was closed, or PHM was suspended."""
        self._cadence.broke(now)

    def stalled(self, now: float) -> None:
        """PHM has been suspended until now: the frames that it reads next may be old."""
        self._stalled = now
        self.broke(now)

    def heartbeat(self, now: float, message: Any, link: str) -> None:
        self._first = now if self._first is None else self._first
        if self._beat is not None and now - self._beat[0] > self._silent_s:
            self._before_pause, self._resumed = self._beat[0], now
        booting = message.system_status in BOOTING
        if booting and not self._booting and self._beat is not None and self._reboot(now, armed=self._was_armed(now)):
            self._boot = None
        self._booting = booting
        late_s = 0.0 if self._beat is None else self._late_s(self._beat[0], None)
        self._beat, self._spoke = (now, message, link), now
        self._cadence.heartbeat(now, late_s)
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self._said[link] = (now, armed)
        self._reports.heartbeat(now, armed, link)
        if armed:
            self._disarmed_from = None
        elif self._disarmed_from is None or now - self._said_armed.get(False, now) > self._timeout_s:
            self._disarmed_from = now
        self._said_armed[armed] = now
        if not self._armed or self._armed[-1][1] != armed:
            self._armed.append((now, armed))

    def booted(self, now: float, time_boot_ms: int) -> None:
        """Record the time since boot that the autopilot reports."""
        self._spoke = now
        new_s = time_boot_ms / 1000.0
        old_s = self._boot[1] if self._boot is not None else 0.0
        wrapped = old_s > WRAPS_AT_S - WRAP_S and new_s < WRAP_S
        if new_s < old_s - BACK_S and not wrapped:
            self._reboot(now, armed=self._armed_before(now - new_s, BACK_S), began=now - new_s)
        self._boot = (now, new_s)

    def ready(self, now: float) -> None:
        """It says that it has started. After other evidence of the same start, or just after PHM's, that is nothing new."""
        self._spoke = now
        recent = [at for at in (self._first, self._rebooted) if at is not None and now - at < START_S]
        if self._first is None or self._booting or recent:
            return
        self._reboot(now, armed=self._was_armed(now))
        self._boot = None

    def commanded(self, now: float) -> None:
        """It has acknowledged a command to reboot."""
        self._spoke = self._commanded = now

    def boot_s(self, now: float) -> float | None:
        """How long it has been running, in seconds; None: unknown."""
        return self._boot[1] + now - self._boot[0] if self._boot is not None else None

    def identity_shared(self, now: float) -> bool:
        """Whether two autopilots use one identity: from their times since boot, or from their armed states."""
        rebooting = len(self._seen) == TWINS and self._seen[-1] - self._seen[0] < TWINS_S
        changes = [at for at, _ in self._armed][-FLIPS:]
        flipping = len(changes) == FLIPS and changes[-1] - changes[0] < FLIPS_S
        return (rebooting and now - self._seen[-1] < TWINS_S) or (flipping and now - changes[-1] < FLIPS_S)

    def fact(
        self, now: float, read_at: Callable[[str], float | None] = lambda link: None, unread_s: float = 0.0
    ) -> AutopilotFact | None:
        """The fact; None if never received. read_at: until when the link of this name has been read, None if unknown.
        unread_s: how long its link should have been read, and was not."""
        if self._beat is None:
            return None
        received, message, link = self._beat
        armed = any(said for at, said in self._said.values() if received - at <= self._timeout_s)
        ages = {said: now - at for said, at in self._said_armed.items()}
        return AutopilotFact(
            now - received,
            armed,
            message.custom_mode,
            message.system_status,
            link,
            self.boot_s(now),
            self.reboots,
            now - self._rebooted if self._rebooted is not None and not self.identity_shared(now) else None,
            self._rebooted_armed,
            self._cadence.due_s(),
            self._overdue(read_at(link)),
            now - self._spoke,
            ages.get(True),
            ages.get(False),
            None if self._stalled is None else now - self._stalled,
            None if self._boot is None else now - self._boot[0],
            None if self._disarmed_from is None else now - self._disarmed_from,
            max(min(unread_s, self._timeout_s), self._late_s(received, self._timeout_s)),
            None if self._commanded is None else now - self._commanded,
            self._reports.contradicted(),
            None if self._reports.landed is None else now - self._reports.landed,
        )

    def _reboot(self, now: float, *, armed: bool, began: float | None = None) -> bool:
        """Record evidence of a reboot. began: when it started, if known. Return whether it is another reboot than the last."""
        last, self._rebooted = self._rebooted, now
        same = last is not None and now - last < START_S
        # What it reports while it starts, always disarmed, does not revoke that it was armed before.
        self._rebooted_armed = armed or (same and self._rebooted_armed)
        if last is not None:
            silent = self._before_pause is not None and self._before_pause >= last
            same = same and not silent and (began is None or began <= last + BACK_S)
        self._seen.append(now)
        self._cadence.broke(now)
        self._booting, self._commanded = True, None
        self.reboots += 0 if same else 1
        return not same

    def _was_armed(self, now: float) -> bool:
        """Whether it was armed before the start that is observed now. Disarmed heartbeats after a silence, or from one link
        while another one is behind, may be of that start."""
        recently = now - self._said_armed.get(True, float("-inf")) <= self._silent_s
        return recently or self._armed_before(now, START_S)

    def _armed_before(self, moment: float, within_s: float) -> bool:
        """The armed state before `moment`, or before the silence that ended less than `within_s` earlier."""
        if self._before_pause is not None and moment - self._resumed < within_s:
            moment = min(moment, self._before_pause)
        return self._armed_at(moment)

    def _overdue(self, read_at: float | None) -> bool:
        speaks = read_at is not None and read_at - self._spoke < ALIVE_S
        return self._cadence.overdue(None if speaks else read_at, self._late_s)

    def _armed_at(self, moment: float) -> bool:
        """The armed state as last received before `moment`: after a reboot the first heartbeat, disarmed, may arrive
        before the new time since boot."""
        return next((armed for at, armed in reversed(self._armed) if at <= moment), False)
