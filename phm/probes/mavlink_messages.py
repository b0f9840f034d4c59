"""Keeps the newest of the MAVLink messages that own checks name, and requests those that do not arrive."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from phm.core.clock import Clock
from phm.core.settings import CustomCheckSettings, EndpointSettings, MavlinkCheckSettings
from phm.facts import AutopilotFact, MessageValue
from phm.probes.mavlink_values import not_known
from phm.transport.dialect import mavlink, message_class
from phm.transport.mavlink import MavlinkHub
from phm.transport.mavlink_endpoint import IDLE_S
from phm.transport.priority import MessagePriority

MOST_INSTANCES = 16
"""Of one message from one component; further ones are ignored."""
MISSING_S, MISSING_PERIODS = 3.0, 3.0
"""A requested message that does not arrive for longer is requested (again): a reboot ends all requested streams."""
AGAIN_S = 10.0
PRESENT_S = 3.0
"""Nothing is requested from an autopilot whose last HEARTBEAT is older."""
MAX_TEXT = 256


class _Key(NamedTuple):
    message: str
    component: int
    instance: int | None


class _Received(NamedTuple):
    at: float
    message: Any
    link: str


class MavlinkMessages:
    """A `phm.facts.MessageProbe`. Nothing is decoded or kept that no check names."""

    def __init__(
        self,
        hub: MavlinkHub,
        agent_id: int,
        endpoints: Sequence[EndpointSettings],
        custom: Sequence[CustomCheckSettings],
        clock: Clock,
        autopilot: Callable[[], AutopilotFact | None],
    ) -> None:
        """autopilot: the newest state of the autopilot, to which requests are sent."""
        self._hub, self._clock, self._autopilot = hub, clock, autopilot
        self._system = agent_id
        self._links = frozenset(entry.key for entry in endpoints if entry.to_autopilot)
        checks = [entry for entry in custom if isinstance(entry, MavlinkCheckSettings)]
        self._classes = {
            entry.message: found for entry in checks if (found := message_class(entry.message)) is not None
        }
        self._names = {kind.id: name for name, kind in self._classes.items()}
        self._wanted = frozenset((entry.message, entry.component) for entry in checks)
        self._periods = _periods(entry for entry in checks if entry.message in self._classes)
        self._requested: dict[tuple[str, int], float] = {}
        self._received: dict[_Key, _Received] = {}
        self._lock = threading.Lock()
        if self._names:
            hub.listen(self._receive, self._names)
        if self._periods:
            hub.watch(self._request)

    def values(self, message: str, field: str, *, component: int, instance: int | None) -> tuple[MessageValue, ...]:
        kind = self._classes.get(message)
        if kind is None:
            return ()
        with self._lock:
            received = [
                (key, one)
                for key, one in self._received.items()
                if (key.message, key.component) == (message, component)
            ]
        found = [self._value(kind, field, key, one) for key, one in received if instance in (None, key.instance)]
        return tuple(sorted(found, key=lambda value: value.instance or 0))

    def _value(self, kind: Any, field: str, key: _Key, received: _Received) -> MessageValue:
        name, bracket, index = field.partition("[")
        raw = getattr(received.message, name)
        raw = raw[int(index.rstrip("]"))] if bracket else raw
        age_s = self._clock.mono() - received.at
        late_s = max(self._unread_s(received.link), self._clock.late_s(received.at))
        if isinstance(raw, str):
            return MessageValue(age_s, None, raw[:MAX_TEXT], False, "", key.instance, received.link, min(age_s, late_s))
        unknown, unit = not_known(key.message, name, raw), str(kind.fieldunits_by_name.get(name, ""))
        number, text = (None, f"{raw:g}") if unknown else (float(raw), "")
        return MessageValue(age_s, number, text, unknown, unit, key.instance, received.link, min(age_s, late_s))

    def _unread_s(self, link: str) -> float:
        """How long an open link should have been read, and was not."""
        read_at = self._hub.read_at(link)
        return 0.0 if read_at is None else max(0.0, self._clock.mono() - read_at - IDLE_S)

    # ------------------------------------------------------------ from the endpoints' threads

    def _receive(self, message: Any, link: str) -> None:
        name, component = self._names[message.get_msgId()], message.get_srcComponent()
        if link not in self._links or message.get_srcSystem() != self._system or (name, component) not in self._wanted:
            return
        field = self._classes[name].instance_field
        key = _Key(name, component, None if field is None else int(getattr(message, field)))
        with self._lock:
            several = sum((one.message, one.component) == (name, component) for one in self._received)
            if key in self._received or several < MOST_INSTANCES:
                self._received[key] = _Received(self._clock.mono(), message, link)

    def _request(self) -> None:
        """Request what does not arrive by the link of the autopilot's newest HEARTBEAT."""
        pilot, now = self._autopilot(), self._clock.mono()
        if pilot is None or pilot.age_s > PRESENT_S:
            return
        for (name, component), period_s in self._periods.items():
            with self._lock:
                times = [
                    one.at for key, one in self._received.items() if (key.message, key.component) == (name, component)
                ]
            limit_s = max(MISSING_S, MISSING_PERIODS * period_s)
            sent = self._requested.get((name, component), float("-inf"))
            if now - max(times, default=float("-inf")) <= limit_s or now - sent < max(AGAIN_S, limit_s):
                continue
            self._requested[name, component] = now
            request = mavlink.MAVLink_command_long_message(
                self._system, component, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                self._classes[name].id, period_s * 1e6, 0, 0, 0, 0, 0,
            )  # fmt: skip
            self._hub.send(request, MessagePriority.REQUEST, key=f"interval {name} {component}", link=pilot.link)


def _periods(checks: Iterable[MavlinkCheckSettings]) -> dict[tuple[str, int], float]:
    """Requested seconds between two messages, by message and component: the shortest of all checks."""
    found: dict[tuple[str, int], float] = {}
    for entry in checks:
        if entry.request is not None:
            key = (entry.message, entry.component)
            found[key] = min(found.get(key, float("inf")), 1.0 / entry.request)
    return found
