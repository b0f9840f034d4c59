"""The daemon: starts what `phm.runtime.wiring` has built, supervises it, hands over to its successor, and stops in order."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import threading
from collections.abc import Callable, Iterator
from functools import partial

from phm.api import Check
from phm.checking import registry
from phm.core import threads
from phm.core.closing import ShutdownSequence
from phm.probes.logs import Logs
from phm.recovery.base import Action
from phm.recovery.executor import Executor
from phm.recovery.persistence.state import PersistedState
from phm.reporters.base import Reporter
from phm.runtime.components import Components
from phm.runtime.shutdown_marker import ShutdownMarker

SUPERVISE_S = 1.0
"""How often `supervise` is to be called."""
WATCHDOG_EVERY = 30
"""Calls of `supervise` after which a watchdog process that ended is started again."""
STALLED_END_S = 30.0
"""A daemon that has stalled for this long exits: Docker restarts a process that exits, not one that hangs."""
STOP_S = 6.0
"""Limit for all parts that end, together (`phm.runtime.service.END_S`)."""
PROBE_S = 3.0
"""Limit for one probe: the ROS child publishes PHM's last diagnostics."""


class Daemon:
    """One agent's PHM. `start` returns immediately, every part has its own threads, and `stop` ends them in order.

    Two orders matter: reporters subscribe before the first result, and the MAVLink reporter closes before the
    endpoints do, so that its farewell HEARTBEAT is sent.
    """

    def __init__(self, components: Components, marker: ShutdownMarker, previous: Daemon | None = None) -> None:
        """previous: the daemon that this one replaces in `start`, after a reload."""
        self.components, self.marker, self._previous = components, marker, previous
        self.clock, self.pipeline = components.clock, components.pipeline
        self._watchdog = components.process.watchdog
        self._subscribers: tuple[object, ...] = ()
        self._logs: Logs | None = None
        """Where the checks of logs were, for the successor."""
        self._supervised = self._stalled = 0

    # ------------------------------------------------------------ start

    def start(self) -> None:
        parts, previous, self._previous = self.components, self._previous, None
        if previous is None:
            parts.health.crashed_before = self.marker.begin()
        parts.persistence.restore(previous._hand_over() if previous is not None else None)
        if previous is not None:
            self._resume_probes(previous)
        restored, requests = parts.pipeline.open_faults(), parts.persistence.requests()
        parts.reporters.start(dataclasses.replace(parts.reporter_context, restored=restored, requests=requests))
        self._start_recovery()
        parts.control.execute = parts.handler.execute
        if previous is None:
            parts.control.start()
        if parts.mavlink_commands is not None:
            before = previous.components.mavlink_commands if previous is not None else None
            if before is not None:
                parts.mavlink_commands.resume(before)
            parts.mavlink_commands.start()
        self._report_unusable_plugins()
        parts.probes.start(links=previous is None)
        threads.start(threading.Thread(target=self._join_networks, name="phm-join", daemon=True))
        parts.loop.start()  # before the many threads of the checks, for which there may be no room
        parts.scheduler.start()

    def _resume_probes(self, previous: Daemon) -> None:
        """Keep what cannot be read again: where logs were, how containers that are disconnected now were connected, and who has sent on
        the links."""
        parts, before = self.components, previous.components
        parts.probes.resume_links(before.probes)
        if previous._logs is not None:
            parts.probes.logs.resume(previous._logs)
        # A key may be that of another container now.
        known = {(one.key, one.name, one.label) for one in before.settings.containers}
        kept = {one.key for one in parts.settings.containers if (one.key, one.name, one.label) in known}
        parts.probes.docker.resume(before.probes.docker, kept)

    def _start_recovery(self) -> None:
        parts, executor, relief = self.components, self.components.executor, self.components.relief
        parts.persistence.resume(executor)
        parts.bus.subscribe("recovery", executor.handle, kinds=Executor.kinds, key=Executor.key)
        if parts.may_relieve or relief.kept():
            parts.bus.subscribe("relief", relief.handle, kinds=relief.kinds, tick=relief.tick, period_s=relief.period_s)
        parts.holds.start()

    def _join_networks(self) -> None:
        self.components.join_networks(self.components.probes.start_ros)

    def _report_unusable_plugins(self) -> None:
        groups: tuple[tuple[str, type], ...] = (
            (registry.CHECKS, Check),
            (registry.REPORTERS, Reporter),
            (registry.ACTIONS, Action),
        )
        for group, base in groups:
            for found in registry.find(group, base):
                if found.loaded is None:
                    self.pipeline.note("PHM", f"{group} {found.name} from {found.source} is not used: {found.problem}")

    # ------------------------------------------------------------ run

    def supervise(self) -> bool:
        """To be called every SUPERVISE_S; False when PHM has stalled for STALLED_END_S and must exit.

        Calls are counted, not seconds: a pause of the entire machine does not count as a stall.
        """
        self._supervised += 1
        self._stalled = 0 if self.components.health.alive() else self._stalled + 1
        threads.retry()
        if self._watchdog is not None and self._supervised % WATCHDOG_EVERY == 0:
            self._watchdog.start_again()
        return self._stalled * SUPERVISE_S < STALLED_END_S

    @property
    def alive(self) -> bool:
        """Whether the last call of `supervise` found that PHM works."""
        return self._stalled == 0

    def wake(self) -> None:
        """PHM was stopped (SIGSTOP) and continues: run the main loop now."""
        self.components.loop.wake()

    def why_not_reload(self) -> str:
        """Why a reload must wait, as a sentence; empty: it need not. The next daemon would not know of these."""
        busy = self.components.executor.in_progress()
        if busy:
            actions = ", ".join(f"{action} of {target}" for target, action in busy.items())
            return f"an action is in progress ({actions}): reload again when it is finished"
        stopping = self.components.holds.undecided()
        if stopping:
            again_s = math.ceil(max(stopping.values())) or 1
            return f"an operator may be stopping {', '.join(stopping)}: reload again in {again_s} s"
        ending = [entry.key for entry in self.components.settings.containers if self.pipeline.is_stopping(entry.key)]
        if ending:
            return f"{', '.join(ending)} received a stop signal and has not exited yet: reload again when it has"
        return ""

    # ------------------------------------------------------------ stop

    def stop(self, most_s: float | None = None, also: Callable[[], object] | None = None) -> tuple[str, ...]:
        """End every part in order; the names of those that hang. most_s: limit for all together, if less than STOP_S. also: ends what
        delivers configurations to this daemon.
        """
        limit_s = STOP_S if most_s is None else min(STOP_S, most_s)
        parts, closing = self.components, ShutdownSequence(self.clock, limit_s)
        parts.loop.stop()
        closing.step("marker", self.marker.end, 0.5)  # first: the stop was requested, whatever hangs after this
        if also is not None:
            closing.step("delivery", also, 0.5)
        if self._watchdog is not None:
            closing.step("watchdog", self._watchdog.close, 0.5)
        self.pipeline.note("PHM", "PHM is stopping")
        closing.step("control", parts.control.close, 0.5)
        self._stop_recovery(closing)
        closing.step("relief", parts.relief.end, 1.0)
        self._stop_checks(closing)
        closing.step("events", partial(parts.bus.close, 1.0), 1.5)
        for name, close in parts.reporters.closers():
            closing.step(name, close, 1.0)
        closing.step("state", parts.persistence.close, 1.0)
        for name, close in parts.probes.closers():
            closing.step(name, close, PROBE_S)
        return tuple(closing.hung)

    def _stop_recovery(self, closing: ShutdownSequence) -> None:
        if self.components.mavlink_commands is not None:
            closing.step("commands", self.components.mavlink_commands.close, 0.5)
        self.components.holds.close()
        self.components.executor.stop()

    def _stop_checks(self, closing: ShutdownSequence) -> None:
        self.components.scheduler.end()
        self.components.probes.engine.close()  # aborts the Docker calls that checks and actions wait for
        closing.step("checks", partial(self.components.scheduler.stop, 1.0), 1.5)

    # ------------------------------------------------------------ reload

    def _hand_over(self) -> PersistedState:
        """End everything but links, control socket and watchdog; what this daemon knows. The main loop and the reporters end last,
        so that HEARTBEATs continue until the next daemon sends its own.
        """
        parts, closing = self.components, ShutdownSequence(self.clock, STOP_S)
        parts.control.pause()
        self._stop_recovery(closing)
        self._stop_checks(closing)
        self._logs = parts.probes.logs.hand_over()
        for name, close in parts.probes.closers(links=False):
            closing.step(name, close, PROBE_S)
        parts.loop.stop()
        closing.step("loop", partial(parts.loop.join, 1.0), 1.0)
        state = parts.persistence.state()  # the loop opens faults, at the end of their grace
        closing.step("events", partial(parts.bus.close, 1.0), 1.5)
        for name, close in parts.reporters.closers(last=False):
            closing.step(name, close, 1.0)
        if parts.probes.mavlink is not None:
            parts.probes.mavlink.forget(self._subscribers)
        return state

    @contextlib.contextmanager
    def handover(self) -> Iterator[None]:
        """While the successor is built: subscribers of the links that are added meanwhile are the successor's. If it cannot be built,
        they are removed."""
        hub = self.components.probes.mavlink
        self._subscribers = hub.subscribers() if hub is not None else ()
        try:
            yield
        except BaseException:  # whatever ends it, also a signal: raised again below
            if hub is not None:
                hub.forget(each for each in hub.subscribers() if each not in self._subscribers)
            raise
