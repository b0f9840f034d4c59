"""Follows what happens to the configured containers: the engine's event stream, and a comparison beside it.

The stream is fast but loses events (the engine drops a slow reader and keeps only 256), so every few
seconds and after every reconnect the containers are inspected and compared with what the stream led us
to expect; each lost event is published as an event of its own.
"""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from phm.core import threads
from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.core.model import Stamp
from phm.core.settings import ContainerSettings, DockerSettings
from phm.facts import CannotTell, EventStreamFact
from phm.probes.docker_facts import TimeBudget, find
from phm.probes.docker_reconcile import ExpectedState, after, differences
from phm.transport.docker import DockerEngine, EngineTimeout, EventStream

logger = logging.getLogger(__name__)

BACKOFF_S = 0.1
BACKOFF_MAX_S = 5.0
CONFIRM_S = 0.2
"""A difference is looked at again after this: the event that explains it may be on its way."""
BEHIND_S = 10.0
"""After this time a reader that is behind hangs or never catches up: `caught_up` no longer waits for it."""
BEHIND_LOOK_S = 0.005
AGAIN_S = 1.0
"""The engine reports each disconnect twice, a few milliseconds apart (seen with 20.10)."""
KILL_S = 11.0
"""A container ends within this time after SIGKILL: the engine waits 10 s for it."""
STOP_S = 121.0
"""A stop takes at most this long, or as long as the container asks for. The engine does not report the time-out that
`docker stop -t` gives, but only that it is over, by SIGKILL."""
ENDLESS_STOP_S = 601.0
"""The same for a container that asks to be waited for without an end."""
MISSED_S = 2.0
"""The engine replays what happened while the stream was closed, from its last 256 events, those of healthchecks included. After
a longer interruption some may be missing."""
_DEADLY = ("2", "3", "15")
_MAX_IDS = 1000
REPLACES = "com.docker.compose.replace"
"""Label by which Compose marks a container that it makes to take the place of another (seen with Compose 2.26)."""
CONTAINER_ACTIONS = (
    "create",
    "start",
    "kill",
    "die",
    "stop",
    "restart",
    "pause",
    "unpause",
    "oom",
    "health_status",
    "destroy",
    "rename",
)
NETWORK_ACTIONS = ("create", "connect", "disconnect", "destroy")
# The engine matches actions by their beginning once `health_status` is among them: exec events stay out.
ENDINGS = ("kill", "die", "stop", "destroy")
FILTERS = {"type": ("container", "network"), "event": tuple(dict.fromkeys((*CONTAINER_ACTIONS, *NETWORK_ACTIONS)))}


@dataclass(frozen=True, slots=True)
class DockerEvent:
    """Something that happened to a configured container or to a network.

    kind:   container or network.
    key:    the container's key in the configuration, or the network's name.
    action: one of CONTAINER_ACTIONS or NETWORK_ACTIONS, or ``replace``: Compose has made the one to take its place.
    detail: e.g. ``exit code 137``, ``unhealthy``, ``signal 15`` for kill (which `docker stop` sends first), or empty.
    container: for network events the key of the container concerned, when it is a configured one.
    lost:   not in the stream; found by the comparison.
    id:     of the container, or of the one that the comparison found; empty: not known.
    end_s:  for a `kill` after which the container is to end: within how many seconds at most; else 0.
    """

    kind: str
    key: str
    action: str
    detail: str
    at: Stamp
    container: str = ""
    lost: bool = False
    end_s: float = 0.0
    id: str = ""

    @property
    def subjects(self) -> frozenset[str]:
        """What it wakes: see `phm.api.Check.wakes`."""
        return frozenset({f"container:{self.key}" if self.kind == "container" else "network"})

    @property
    def harmless(self) -> bool:
        """A signal after which the container is not meant to end, e.g. SIGHUP to have it read its configuration."""
        return self.action == "kill" and self.end_s == 0

    @property
    def ends_life(self) -> bool:
        """A container has ended, or is gone."""
        return self.kind == "container" and self.action in ("die", "destroy")

    @property
    def begins_life(self) -> bool:
        """A container was started. The engine's own `restart` only follows its `start`; a lost one replaces both."""
        return self.kind == "container" and (self.action == "start" or (self.action == "restart" and self.lost))

    def __str__(self) -> str:
        of = f" of {self.container}" if self.container else ""
        return f"{self.kind} {self.key}{of}: {self.action}" + (f" ({self.detail})" if self.detail else "")


class ContainerWatcher:
    """Two threads: one follows the stream, one compares. `on_event` is called from either, one at a time; `on_turn` when the
    stream broke, could not be opened, or is open again: mostly the engine itself has gone or come.

    Invariant: `_expected`, `_stops`, `_ids`, `_current`, `_left` and `_touched` are read and written with `_lock` held.
    """

    def __init__(
        self,
        engine: DockerEngine,
        containers: Sequence[ContainerSettings],
        settings: DockerSettings,
        clock: Clock,
        on_event: Callable[[DockerEvent], None],
        on_turn: Callable[[], None] = lambda: None,
    ) -> None:
        self._engine, self._clock, self._on_event, self._on_turn = engine, clock, on_event, on_turn
        self._containers = {entry.key: entry for entry in containers}
        self._networks = {name for entry in containers for name in entry.networks}
        self._compare_s = settings.compare
        self._expected: dict[str, ExpectedState] = {}
        self._stops: dict[str, tuple[int, float | None]] = {}
        """By which signal each container is stopped, and how long it asks to be waited for."""
        self._ids: dict[str, str] = {}
        self._current: dict[str, str] = {}
        """The id of the container that has each key's name now, or was last started under its label."""
        self._left: dict[tuple[str, str], int] = {}
        self._touched: dict[str, int] = dict.fromkeys(self._containers, 0)
        self._lock, self._publishing = threading.Lock(), threading.Lock()
        self._stopping, self._compare_now = threading.Event(), threading.Event()
        self._stream: EventStream | None = None
        self._connected, self._since = False, ""
        self._opened_at: float | None = None
        self.fact = EventStreamFact(False, clock.mono())
        self._compared_at: float | None = None
        self._behind_since: float | None = None
        self._threads = [
            threading.Thread(target=self._follow, name="phm-docker-events", daemon=True),
            threading.Thread(target=self._compare, name="phm-docker-compare", daemon=True),
        ]

    def start(self) -> None:
        for thread in self._threads:
            threads.start(thread)

    def stop(self) -> None:
        """End both threads; waits at most for a call that is under way."""
        self._stopping.set()
        self._compare_now.set()
        stream = self._stream
        if stream is not None:
            stream.close()
        for thread in self._threads:
            threads.join(thread, self._engine.timeout_s + 1)

    def healthy(self) -> bool:
        """The stream is open, and the last comparison that succeeded is not older than three periods."""
        at = self._compared_at
        limit_s = 3 * self._compare_s + self._engine.timeout_s
        return self._connected and at is not None and self._clock.mono() - at <= limit_s

    def caught_up(self) -> bool:
        """Whether `on_event` has returned for every event that the engine had sent when this was asked."""
        stream = self._stream
        if stream is None or stream.caught_up():
            self._behind_since = None
            return True
        now, since = self._clock.mono(), self._behind_since
        if since is None:
            self._behind_since = now
        return since is not None and now - since > BEHIND_S

    def catch_up(self) -> None:
        """Wait until it has; not at all in most cases, and BEHIND_S at most."""
        while not self.caught_up() and not self._stopping.is_set():
            self._clock.wait(self._stopping, BEHIND_LOOK_S)

    # ------------------------------------------------------------ the stream

    def _follow(self) -> None:
        backoff = Backoff(BACKOFF_S, BACKOFF_MAX_S)
        while not self._stopping.is_set():
            opened_at = self._clock.mono()
            try:
                self._read_stream()
                silent = False
            except EngineTimeout:
                silent = self._connected  # nothing happened for long: no failure
            except CannotTell as error:
                silent = False
                logger.debug("event stream: %s", error)
            except Exception:  # a defect in reading must not end the watch
                silent = False
                logger.exception("the event stream could not be read")
            if self._connected:
                self._connected, self.fact = False, replace(self.fact, open=False, since=self._clock.mono())
            if not silent:
                self._turned()
            # A stream that is dropped as soon as it is opened must not be reopened ten times a second.
            if silent or self._clock.mono() - opened_at > BACKOFF_MAX_S:
                backoff.reset()
            if not self._stopping.is_set():
                self._clock.wait(self._stopping, backoff.next_s())

    def _read_stream(self) -> None:
        opened_at = self._clock.mono()
        with self._engine.events(self._since or self._since_opened(opened_at), FILTERS) as stream:
            self._stream = stream
            if self._stopping.is_set():
                return
            self._opened_at = opened_at if self._opened_at is None else self._opened_at
            self._connected, self.fact = True, self._reopened(opened_at)
            self._turned()
            self._compare_now.set()
            for raw in stream:
                event = self._understand(raw)
                if event is not None:
                    self._publish(event)

    def _since_opened(self, now: float) -> str:
        """From when on to replay events when none has come yet: since the stream was first open. Empty: it never was."""
        return "" if self._opened_at is None else f"{self._clock.utc() - (now - self._opened_at):.9f}"

    def _reopened(self, opened_at: float) -> EventStreamFact:
        replayed = self.fact.complete_since <= opened_at and opened_at - self.fact.since <= MISSED_S
        now = self._clock.mono()
        return EventStreamFact(True, now, self.fact.complete_since if replayed else now)

    def _understand(self, raw: Mapping[str, Any]) -> DockerEvent | None:
        """The event as a `DockerEvent`, applied to the expected state; None when it concerns no configured container."""
        actor = raw.get("Actor")
        actor = actor if isinstance(actor, Mapping) else {}
        attributes = actor.get("Attributes")
        attributes = attributes if isinstance(attributes, Mapping) else {}
        nanoseconds = raw.get("timeNano")
        if isinstance(nanoseconds, int):
            self._since = f"{(nanoseconds + 1) // 10**9}.{(nanoseconds + 1) % 10**9:09d}"
        action, _, detail = str(raw.get("Action", "")).partition(": ")
        if raw.get("Type") == "network":
            at_ns = nanoseconds if isinstance(nanoseconds, int) else 0
            return self._network_event(action, str(actor.get("ID", "")), attributes, at_ns)
        if raw.get("Type") != "container" or action not in CONTAINER_ACTIONS:
            return None
        container_id = str(actor.get("ID", ""))
        key = self._key_of(container_id, attributes, action)
        if key and action in ENDINGS and self._is_replaced(key, container_id):
            return None
        if not key:
            replaced = self._replaced(attributes) if action == "create" else ""
            return DockerEvent("container", replaced, "replace", "", self._clock.stamp()) if replaced else None
        with self._lock:
            self._touched[key] += 1
            if key in self._expected:
                self._expected[key] = after(self._expected[key], action, detail, container_id)
        end_s = 0.0
        if action == "die":
            detail = f"exit code {attributes.get('exitCode', 'unknown')}"
        elif action == "kill":
            number = str(attributes.get("signal", "unknown"))
            detail, end_s = f"signal {number}", self._ends_within(key, number)
        return DockerEvent("container", key, action, detail, self._clock.stamp(), end_s=end_s, id=container_id)

    def _ends_within(self, key: str, number: str) -> float:
        """How long a container may take to end after this signal; 0: it is not meant to end."""
        with self._lock:
            stop_signal, asked_s = self._stops.get(key, (int(signal.SIGTERM), None))
        if number == str(int(signal.SIGKILL)):
            return KILL_S
        if number == str(stop_signal):
            return ENDLESS_STOP_S if asked_s is not None and asked_s < 0 else max(STOP_S, (asked_s or 0.0) + KILL_S)
        return KILL_S if number in _DEADLY else 0.0

    def _network_event(
        self, action: str, network_id: str, attributes: Mapping[str, Any], at_ns: int
    ) -> DockerEvent | None:
        name, container = str(attributes.get("name", "")), str(attributes.get("container", ""))
        with self._lock:
            key = self._ids.get(container, "")
            if action not in NETWORK_ACTIONS or not (key or name in self._networks):
                return None
            if key:
                self._touched[key] += 1
            if key in self._expected:
                self._expected[key] = after(self._expected[key], action, name, network_id)
            if self._reported_before(action, (container, network_id), at_ns):
                return None
        return DockerEvent("network", name, action, "", self._clock.stamp(), container=key)

    def _reported_before(self, action: str, ends: tuple[str, str], at_ns: int) -> bool:
        """Whether this is the echo of a disconnect: the same ends, and they were not connected in between."""
        left_ns = self._left.pop(ends, 0)
        if action != "disconnect":
            return False
        if len(self._left) >= _MAX_IDS:
            self._left.clear()
        self._left[ends] = at_ns
        return bool(left_ns and 0 <= at_ns - left_ns < AGAIN_S * 1e9)

    def _is_replaced(self, key: str, container_id: str) -> bool:
        """Whether another container has taken the place of this one: its end is not a fault."""
        with self._lock:
            return self._current.get(key, container_id) != container_id

    def _key_of(self, container_id: str, attributes: Mapping[str, Any], action: str) -> str:
        """Key of the configured container that an event is about; by id also when it was renamed away."""
        with self._lock:
            for key, entry in self._containers.items():
                if _named(entry, attributes):
                    if len(self._ids) >= _MAX_IDS:
                        self._ids.clear()
                    self._ids[container_id] = key
                    if entry.name or action == "start":  # a label may be on several, a name is on one
                        self._current[key] = container_id
                    return key
            return self._ids.get(container_id, "")

    def _replaced(self, attributes: Mapping[str, Any]) -> str:
        """Key of the configured container in whose place Compose has made this one; it has another name until the old one is gone.

        The label holds the id of the old container, or by the version its name, or that without the project.
        """
        old = str(attributes.get(REPLACES, ""))
        if not old:
            return ""
        with self._lock:
            if old in self._ids:
                return self._ids[old]
        named = (entry for entry in self._containers.values() if entry.name)
        return next((entry.key for entry in named if entry.name == old or str(entry.name).endswith(f"-{old}")), "")

    # ------------------------------------------------------------ the comparison

    def _compare(self) -> None:
        while not self._stopping.is_set():
            self._compare_now.clear()
            try:
                complete = self._compare_all()
            except Exception:  # a defect in comparing must not end the watch
                complete = False
                logger.exception("containers could not be compared")
            if complete:
                self._compared_at = self._clock.mono()
            if not self._stopping.is_set():
                self._clock.wait(self._compare_now, self._compare_s)

    def _compare_all(self) -> bool:
        """Whether the engine answered about every container."""
        answered = [self._compare_one(key) for key in self._containers if not self._stopping.is_set()]
        return all(answered)

    def _compare_one(self, key: str) -> bool:
        """Publish what the stream missed about one container; False when the engine did not answer."""
        seen = self._look(key)
        if seen is None:
            return False
        touched, now = seen
        if key in self._expected and differences(self._expected[key], now):
            self._clock.wait(self._stopping, CONFIRM_S)
            seen = self._look(key)
            if seen is None:
                return False
            touched, now = seen
        with self._lock:
            if self._touched[key] != touched:
                return True  # the stream spoke meanwhile: what was seen may be older than that
            expected = self._expected.get(key)
            self._expected[key] = now
            if now.id:
                self._ids = {known: other for known, other in self._ids.items() if other != key} | {now.id: key}
                self._current[key] = now.id
        for kind, action, detail in differences(expected, now) if expected is not None else ():
            subject, container, text = (detail, key, "") if kind == "network" else (key, "", detail)
            self._publish(
                DockerEvent(kind, subject, action, text, self._clock.stamp(), container, lost=True, id=now.id or "")
            )
        return True

    def _look(self, key: str) -> tuple[int, ExpectedState] | None:
        """How often the stream had spoken about the container before we looked, and what we saw."""
        with self._lock:
            touched = self._touched[key]
        try:
            fact = find(self._engine, self._containers[key], TimeBudget(self._clock, self._engine.timeout_s))
        except CannotTell as error:
            logger.debug("comparison of %s: %s", key, error)
            return None
        if fact is not None:
            with self._lock:
                self._stops[key] = (fact.stop_signal, fact.stop_timeout_s)
        return touched, ExpectedState.of(fact)

    def _turned(self) -> None:
        if self._stopping.is_set():
            return
        try:
            self._on_turn()
        except Exception:  # the listener's defect must not end the watch
            logger.exception("the listener of the event stream failed")

    def _publish(self, event: DockerEvent) -> None:
        with self._publishing:
            if self._stopping.is_set():
                return
            try:
                self._on_event(event)
            except Exception:  # the listener's defect must not cost the next event
                logger.exception("an event could not be delivered: %s", event)


def _named(entry: ContainerSettings, attributes: Mapping[str, Any]) -> bool:
    """Whether an event's attributes (name and labels) are those of a configured container."""
    if entry.name:
        return bool(attributes.get("name") == entry.name)
    label, has_value, value = (entry.label or "").partition("=")
    return label in attributes and (not has_value or attributes[label] == value)
