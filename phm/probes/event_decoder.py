"""What an event of the engine means for the configured containers, and what of it the stream has lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from phm.core.clock import Clock
from phm.core.settings import ContainerSettings
from phm.probes.docker_event import CONTAINER_ACTIONS, ENDINGS, NETWORK_ACTIONS, DockerEvent
from phm.probes.docker_facts import has_label
from phm.probes.docker_reconcile import ExpectedState, after, differences

AGAIN_S = 1.0
"""The engine reports each disconnect twice, a few milliseconds apart (seen with 20.10)."""
KILL_S = 11.0
"""A container ends within this time after SIGKILL: the engine waits 10 s for it."""
STOP_S = 121.0
"""A stop takes at most this long, or as long as the container asks for. The engine does not report the time-out that
`docker stop -t` gives, but only that it is over, by SIGKILL."""
ENDLESS_STOP_S = 601.0
"""The same for a container that asks to be waited for without an end."""
_DEADLY = ("2", "3", "15")
_MAX_IDS = 1000
REPLACES = "com.docker.compose.replace"
"""Label by which Compose marks a container that it makes to take the place of another (seen with Compose 2.26)."""


OTHERS = ("start", "die", "rename")


class EventDecoder:
    """Thread-safe.

    Invariant: `_expected`, `_stops`, `_ids`, `_current`, `_left` and `_touched` are read and written with `_lock` held.
    """

    def __init__(self, containers: Sequence[ContainerSettings], clock: Clock) -> None:
        self._clock = clock
        self._containers = {entry.key: entry for entry in containers}
        self._networks = {name for entry in containers for name in entry.networks}
        self.since = ""
        """Time after the newest event, as the engine writes it; empty: there was none."""
        self.others = 0
        """Counts events after which another set of containers that are not configured may run."""
        self._expected: dict[str, ExpectedState] = {}
        self._stops: dict[str, tuple[int, float | None]] = {}
        """By which signal each container is stopped, and how long it asks to be waited for."""
        self._ids: dict[str, str] = {}
        self._current: dict[str, str] = {}
        """The id of the container that has each key's name now, or was last started under its label."""
        self._left: dict[tuple[str, str], int] = {}
        self._touched: dict[str, int] = dict.fromkeys(self._containers, 0)
        self._lock = threading.Lock()

    # ------------------------------------------------------------ the stream

    def decode(self, raw: Mapping[str, Any]) -> DockerEvent | None:
        """An event of the stream as a `DockerEvent`, applied to the expected state; None when it concerns no configured container."""
        actor = raw.get("Actor")
        actor = actor if isinstance(actor, Mapping) else {}
        attributes = actor.get("Attributes")
        attributes = attributes if isinstance(attributes, Mapping) else {}
        nanoseconds = raw.get("timeNano")
        if isinstance(nanoseconds, int):
            self.since = f"{(nanoseconds + 1) // 10**9}.{(nanoseconds + 1) % 10**9:09d}"
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
            self.others += action in OTHERS
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

    def count(self, key: str) -> int:
        """Number of events about this container so far."""
        with self._lock:
            return self._touched[key]

    def learn_stop(self, key: str, stop_signal: int, timeout_s: float | None) -> None:
        """By which signal the container is stopped, and how long it asks to be waited for, seconds."""
        with self._lock:
            self._stops[key] = (stop_signal, timeout_s)

    def differs(self, key: str, found: ExpectedState) -> bool:
        """Whether the container was found in another state than the events lead to expect."""
        with self._lock:
            expected = self._expected.get(key)
        return expected is not None and bool(differences(expected, found))

    def compared(self, key: str, count: int, found: ExpectedState) -> list[DockerEvent]:
        """The events that the stream has lost. count: that of `count` before the state was `found`."""
        with self._lock:
            if self._touched[key] != count:
                return []  # the stream spoke meanwhile: what was found may be older than that
            expected = self._expected.get(key)
            self._expected[key] = found
            if found.id:
                self._ids = {known: other for known, other in self._ids.items() if other != key} | {found.id: key}
                self._current[key] = found.id
        lost = []
        for kind, action, detail in differences(expected, found) if expected is not None else ():
            subject, container, text = (detail, key, "") if kind == "network" else (key, "", detail)
            at = self._clock.stamp()
            lost.append(DockerEvent(kind, subject, action, text, at, container, lost=True, id=found.id or ""))
        return lost


def _named(entry: ContainerSettings, attributes: Mapping[str, Any]) -> bool:
    """Whether an event's attributes (name and labels) are those of a configured container."""
    if entry.name:
        return bool(attributes.get("name") == entry.name)
    return has_label(entry.label or "", attributes)
