"""The daemon's side of the ROS probe: supervises the child process that observes ROS, and answers from its reports.

Whatever happens to the child, `snapshot` returns immediately: its newest snapshot, or `CannotTell` with a sentence. A child
that exits, falls silent or grows too large is replaced, at increasing intervals.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from phm.core import threads
from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.core.extras import remedy
from phm.core.scheduling_delay import NOISE_S, ProcessStallMeter, SchedulingDelay
from phm.core.settings import CustomCheckSettings, ReadySettings, RosSettings
from phm.facts import CannotTell, RosFact
from phm.facts.ros import DIAGNOSTICS, DiagnosticFact
from phm.probes.ros.child_environment import child_environ
from phm.probes.ros.child_process import ChildProcess
from phm.probes.ros.graph_snapshot import GraphSnapshot, again_s
from phm.probes.ros.protocol import (
    EXIT_MISSING,
    LINE_LIMIT,
    GraphMessage,
    LogText,
    Message,
    Missing,
    ProtocolError,
    Publish,
    Sandbox,
    Tick,
    decode,
    encode_order,
    encode_wanted,
)
from phm.probes.ros.self_reports import MAX_NAMES, SILENT_MISSES, ConfiguredNames, SelfReports
from phm.probes.ros.stale_nodes import DOUBT_S, StaleNodes
from phm.probes.ros.unnamed_participants import UNNAMED_S, UnnamedParticipants
from phm.probes.ros.unreceived_nodes import UNRECEIVED_S, UnreceivedNodes
from phm.probes.ros.wanted import wanted

NOT_INSTALLED = f"rclpy is not installed here: ROS checks are off; on x86-64 {remedy('ros')}, elsewhere use an image FROM a ROS base"
COMMAND = (sys.executable, "-m", "phm.probes.ros.child")
OVERLONG = f"a message of the ROS child was longer than {LINE_LIMIT // 1000} kB and was dropped: its content is unknown"
CROWDED = "more messages arrive on /phm/beacon than PHM can read: beacons may be lost; see which nodes publish there"
UNKEPT = (
    f"more than {MAX_NAMES} statuses match one pattern of ros.diagnostics.watch, and only the newest are kept: narrow the "
    "pattern, or see which nodes publish them"
)
REPORTED_S = 30.0
"""How long a loss is reported."""
MAX_LOG_TEXTS = 20
"""This many different log texts of the child are written to the log, each once."""


@dataclass(frozen=True, slots=True)
class SupervisorLimits:
    """Deadlines of supervision, in seconds. Tests shorten them."""

    start_s: float = 20.0
    """From start to the first graph message: importing rclpy takes seconds on a small board with an SD card."""
    silent_s: float = 3.0
    """Maximum time between two messages in which the child could run; it sends four a second."""
    starved_s: float = 30.0
    """The maximum in any case. Replacing a child that waits for a core does not help: a start needs more CPU time."""
    memory_period_s: float = 1.0
    """Its DDS participant is checked as often as its memory."""
    doubt_s: float = DOUBT_S
    unnamed_s: float = UNNAMED_S
    unreceived_s: float = UNRECEIVED_S
    backoff_s: float = 0.5
    backoff_max_s: float = 30.0
    steady_s: float = 60.0
    """A child that ran this long resets the back-off."""
    missing_s: float = 60.0
    """Time between attempts without rclpy."""
    last_write_s: float = 0.2
    """Time to write the last array to a child before it is asked to exit."""
    exit_s: float = 2.5
    """Time for a child to publish its last arrays and exit before SIGKILL; on a busy machine it may get no CPU for a second."""


class RosSupervisor:
    """Implements `phm.facts.RosProbe`.

    `on_change` is called when the set of nodes or of endpoints, or a topic's silence changed, and when the snapshot is
    lost; `on_note` with a sentence for the log. Both are called from the probe's own thread and must be quick. One
    lock, held only for moments, guards everything shared with that thread.
    """

    def __init__(
        self,
        ros: RosSettings,
        agent: str,
        clock: Clock,
        on_change: Callable[[], None],
        on_note: Callable[[str], None],
        environ: Mapping[str, str] | None = None,
        *,
        command: Sequence[str] = COMMAND,
        limits: SupervisorLimits = SupervisorLimits(),
        ready: Sequence[ReadySettings] = (),
        custom: Sequence[CustomCheckSettings] = (),
    ) -> None:
        """agent: name of this agent, for its statuses on /diagnostics. ready: `ready` of the containers. custom: own checks."""
        self._clock = clock
        self._on_change = on_change
        self._on_note = on_note
        self._environ = child_environ(ros, os.environ if environ is None else environ)
        looked_for = wanted(ros, agent, ready, custom)
        self._first_line = encode_wanted(looked_for)
        self._nodes = frozenset(looked_for.nodes)
        self._blank = GraphSnapshot(
            self_reports=SelfReports(configured=ConfiguredNames(self._nodes, looked_for.watch)),
            again_s=again_s(ros.grace),
        )
        self._max_memory = ros.max_memory
        self._command = tuple(command)
        self._limits = limits
        self._stale_nodes = StaleNodes(limits.doubt_s)
        self._unnamed = UnnamedParticipants(limits.unnamed_s)
        self._unreceived = UnreceivedNodes(limits.unreceived_s)
        self._lock = threading.Lock()
        self._view = self._blank
        self._late = SchedulingDelay()
        self._orders: dict[str, bytes] = {}
        self._unsent: dict[str, int] = {}
        self._log_texts: set[str] = set()
        self._dropped_s: float | None = None
        self._why = "the ROS child has not been started yet"
        self._renew = ""
        self._closing = False
        self._restarts = 0
        self._pid = 0
        self._sandbox: str | None = None
        self._last_note = ""
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread. Returns immediately."""
        self._thread = threading.Thread(target=self._run, name="phm-ros", daemon=True)
        threads.start(self._thread)

    @property
    def restarts(self) -> int:
        """How often the child was replaced because it failed itself; not counted: `renew`, no rclpy."""
        return self._restarts

    @property
    def pid(self) -> int:
        """Process id of the current child; 0 if there is none."""
        return self._pid

    @property
    def sandbox(self) -> str | None:
        """Restrictions that the kernel does not support; empty: none is missing. None: not known yet."""
        return self._sandbox

    def snapshot(self) -> RosFact:
        """The newest snapshot. Raises CannotTell without a recent one."""
        with self._lock:
            view, why = self._view, self._why
        if view.graph is None:
            raise CannotTell(why)
        fact = view.fact(view.graph, self._clock.mono(), self._late_s)
        if fact.age_s > self._limits.silent_s:
            raise CannotTell(f"the ROS child has not reported the ROS graph for {fact.age_s:.1f} s")
        return fact

    def _late_s(self, since: float, most_s: float | None = None) -> float:
        """For the child, like `Clock.late_s` for the daemon."""
        return self._late.late_s(since, self._clock.mono(), most_s)

    def problems(self) -> tuple[str, ...]:
        """Sentences about parts of the graph that PHM cannot see."""
        with self._lock:
            view, reports = self._view, self._view.self_reports
            times = {OVERLONG: self._dropped_s, CROWDED: reports.lost_at, UNKEPT: reports.unkept_at}
        found = view.graph.problems if view.graph is not None else ()
        now_s = self._clock.mono()
        return (*found, *(words for words, at in times.items() if at is not None and now_s - at < REPORTED_S))

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        """Whether the child publishes there and has no subscriber, as of its last report of the graph, at most a second ago."""
        graph = self._view.graph
        return graph is not None and topic in graph.idle

    def publish(self, statuses: Mapping[str, DiagnosticFact], topic: str = DIAGNOSTICS) -> int:
        """Let the child publish these on `topic`, by name. Never blocks. Ignored while no child responds.

        Returns how many in a row the child has not taken: a waiting array is replaced by a newer one of its topic.
        """
        line = encode_order(Publish(self._clock.utc(), statuses, topic))
        with self._lock:
            if self._view.graph is None or self._closing:
                return 0
            self._unsent[topic] = self._unsent.get(topic, 0) + 1 if topic in self._orders else 0
            self._orders[topic] = line
            self._wake_thread()
            return self._unsent[topic]

    def renew(self, reason: str) -> None:
        """Replace the child intentionally: its network changed. Returns immediately."""
        with self._lock:
            if self._closing:
                return
            self._renew = reason
            self._wake_thread()

    def close(self) -> None:
        """End the child and the thread. Safe to call twice."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
        self._wake_thread()
        if self._thread is not None:
            threads.join(self._thread, self._limits.exit_s + 5.0)
        if self._thread is None or not self._thread.is_alive():
            self._lose("the ROS probe is closed")
            os.close(self._wake)

    # ---- the thread

    def _run(self) -> None:
        backoff = Backoff(self._limits.backoff_s, self._limits.backoff_max_s)
        while not self._closing:
            began_s = self._clock.mono()
            try:
                sentence, wait_s = self._run_child()
            except Exception as error:  # a defect must not end the supervision
                sentence, wait_s = f"the ROS probe failed: {error!r}", None
            if self._clock.mono() - began_s >= self._limits.steady_s:
                backoff.reset()
                self._last_note = ""
            if wait_s is None:
                wait_s = backoff.next_s()
                self._restarts += 1
            self._lose(sentence)
            self._pause(wait_s)
        self._lose("the ROS probe is closed")

    def _run_child(self) -> tuple[str, float | None]:
        """Start a child and supervise it until it ends. Returns why it ended, and how long to wait (None: back off)."""
        with self._lock:
            self._why = "the ROS child is starting" if self._restarts == 0 else f"{self._why}; a new one is starting"
            self._renew = ""
        try:
            child = ChildProcess(self._command, self._environ, self._first_line)
        except OSError as error:
            return self._report(f"the ROS child cannot be started: {error}"), None
        self._pid = child.pid
        missing: list[Missing] = []
        try:
            reason = self._supervise(child, missing)
        finally:
            orderly = self._closing or bool(self._renew)
            child.end(self._limits.exit_s if orderly or child.over else 0.0)
            self._pid = 0
        if self._closing:
            return "the ROS probe is closed", 0.0
        if self._renew:
            return self._report(f"the ROS child is restarted: {self._renew}"), 0.0
        if child.exit_code == EXIT_MISSING and missing:
            return self._report(_missing_sentence(missing[-1])), self._limits.missing_s
        return self._report(f"the ROS child {reason or child.exit_reason()}"), None

    def _supervise(self, child: ChildProcess, missing: list[Missing]) -> str:
        """Read until it must be replaced; returns why, or nothing if it ended by itself or on request."""
        received_s = measured_s = looked_s = self._clock.mono()
        progress, held_s = ProcessStallMeter(child.pid), 0.0
        limit_s = self._limits.start_s
        dropped = 0
        while not child.over and not self._closing and not self._renew:
            self._send_orders(child)
            lines = child.read(min(0.5, limit_s / 2), self._wake)
            self._drain()
            before_s, now_s = looked_s, self._clock.mono()
            looked_s = now_s
            held_s = 0.0 if lines else held_s + max(progress.measure(now_s), self._clock.late_s(before_s))
            if child.dropped > dropped:
                dropped = child.dropped
                self._discard_graph(now_s)
            for line in lines:
                try:
                    message = decode(line)
                except ProtocolError:
                    continue  # invalid lines do not show that it works
                received_s = now_s
                if isinstance(message, Missing):
                    missing.append(message)
                elif isinstance(message, Sandbox):
                    self._note_sandbox(message)
                else:
                    # A text for the log may come before rclpy is imported, which takes most of `start_s`.
                    if isinstance(message, (GraphMessage, Tick)):
                        limit_s = self._limits.silent_s
                    self._take(message, now_s)
            if now_s - received_s - held_s > limit_s or now_s - received_s > limit_s + self._limits.starved_s:
                held = f" (besides {held_s:.0f} s in which it could not run)" if held_s >= 1.0 else ""
                return f"was unresponsive for {limit_s:g} s{held} and was killed"
            if now_s - measured_s >= self._limits.memory_period_s:
                measured_s = now_s
                self._check_participant(now_s)
                if (rss := child.rss_bytes()) > self._max_memory:
                    return f"used {rss / 1e6:.0f} MB, allowed are {self._max_memory / 1e6:.0f} MB, and was killed"
        if self._closing:
            self._finish(child)
        return ""

    def _note_sandbox(self, message: Sandbox) -> None:
        if message.missing and message.missing != self._sandbox:
            self._on_note(f"the ROS child is not fully restricted: {message.missing}")
        self._sandbox = message.missing

    def _check_participant(self, now_s: float) -> None:
        """A node that is listed twice or without a name for too long, or that only others receive, is a defect of this participant:
        replace it."""
        graph = self._view.graph
        if graph is None:
            return
        # Unconfigured nodes must not cause a replacement.
        stale = self._stale_nodes.observe({name: graph.nodes.get(name, 0) for name in self._nodes}, now_s)
        fact = self._view.fact(graph, now_s, self._late_s)
        beating = {name for name in self._nodes if name in fact.beacons and fact.beacons[name].missed < SILENT_MISSES}
        unnamed = self._unnamed.observe(fact.topics, now_s, beating - fact.nodes.keys())
        if stale:
            self.renew(f"{', '.join(stale)} has been listed more than once for {self._limits.doubt_s:g} s")
        elif unnamed:
            names = ", ".join(unnamed[:3])
            self.renew(
                f"{names} is in use, but the graph has not listed all its nodes for {self._limits.unnamed_s:g} s"
            )
        elif unreceived := self._unreceived.observe(fact, self._nodes, now_s):
            names = ", ".join(f"{name}, which {by} receives" for name, by in [*unreceived.items()][:3])
            self.renew(f"it receives no beacon of {names}")

    def _finish(self, child: ChildProcess) -> None:
        """The waiting array may be PHM's last one: the child reads it before the end of its input."""
        self._send_orders(child)
        until_s = self._clock.mono() + self._limits.last_write_s
        while child.writing and not child.over and self._clock.mono() < until_s:
            child.read(0.02, self._wake)
            self._drain()

    def _send_orders(self, child: ChildProcess) -> None:
        with self._lock:
            if self._orders and not child.writing:
                child.send(b"".join(self._orders.values()))
                self._orders.clear()

    def _take(self, message: Message, now_s: float) -> None:
        with self._lock:
            if isinstance(message, (GraphMessage, Tick)) and message.late_s >= NOISE_S:
                self._late.add(now_s - message.late_s, now_s)
            changed = self._view.changed_by(message)
            self._view = self._view.with_message(message, now_s)
        if (
            isinstance(message, LogText)
            and message.text not in self._log_texts
            and len(self._log_texts) < MAX_LOG_TEXTS
        ):
            self._log_texts.add(message.text)
            self._on_note(message.text)
        if changed:
            self._on_change()

    def _discard_graph(self, now_s: float) -> None:
        """Discard the graph after a message that was too long: it may have changed the graph."""
        with self._lock:
            had_one = self._view.graph is not None
            self._view, self._why, self._dropped_s = self._view.without_graph(), OVERLONG, now_s
        self._report(OVERLONG)
        if had_one:
            self._on_change()

    def _lose(self, sentence: str) -> None:
        with self._lock:
            had_one = self._view.graph is not None
            self._view = self._blank
            self._orders.clear()
            self._why = sentence
        if had_one and not self._closing:
            self._on_change()

    def _pause(self, wait_s: float) -> None:
        """Wait until there is something to do: closing, or a renewal."""
        until_s = self._clock.mono() + wait_s
        while not self._closing and not self._renew and (left_s := until_s - self._clock.mono()) > 0:
            if select.select([self._wake], [], [], left_s)[0]:
                self._drain()
        self._drain()

    def _report(self, sentence: str) -> str:
        """Write the sentence to the log, but a repeated one only once: a broken child must not fill the log."""
        if sentence != self._last_note:
            self._last_note = sentence
            self._on_note(sentence)
        return sentence

    def _wake_thread(self) -> None:
        os.eventfd_write(self._wake, 1)

    def _drain(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._wake)


def _missing_sentence(missing: Missing) -> str:
    if missing.module.partition(".")[0] == "rclpy" and "." not in missing.module:
        return NOT_INSTALLED
    return f"rclpy cannot be loaded here: ROS checks are off; {missing.detail}"
