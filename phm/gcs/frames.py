"""MAVLink messages as data. Received numbers are not trusted, and nothing here raises on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from phm.wire.command import COMMAND_ACK, HEARTBEAT, NAMED_VALUE_FLOAT, ONBOARD_COMPUTER_STATUS, STATUSTEXT, TUNNEL
from phm.wire.text import one_line

RADIO_STATUS = 109
IDS = (HEARTBEAT, STATUSTEXT, TUNNEL, RADIO_STATUS, COMMAND_ACK, ONBOARD_COMPUTER_STATUS, NAMED_VALUE_FLOAT)
GCS, ONBOARD_CONTROLLER = 6, 18
"""Values of MAV_TYPE."""
NO_AUTOPILOT = 8
"""The value of MAV_AUTOPILOT_INVALID."""
ARMED = 128
"""The flag MAV_MODE_FLAG_SAFETY_ARMED in base_mode."""
STATES = ("UNINIT", "BOOT", "CALIBRATING", "STANDBY", "ACTIVE", "CRITICAL", "EMERGENCY", "POWEROFF", "TERMINATION")
"""Names of MAV_STATE, by number."""
BOOT, POWEROFF = 1, 7
RESULTS = ("ACCEPTED", "TEMPORARILY_REJECTED", "DENIED", "UNSUPPORTED", "FAILED", "IN_PROGRESS", "CANCELLED")
"""Names of MAV_RESULT, by number."""
_UNKNOWN = 255
"""The value for unknown in RADIO_STATUS."""
_U32, _NO_HEAT = 2**32 - 1, 127
"""The values for unknown in ONBOARD_COMPUTER_STATUS."""
MAX_TEXT = 200
"""Characters that are kept of a text: escapes can make 50 characters longer."""


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The content of a HEARTBEAT."""

    system: int
    component: int
    kind: int
    autopilot: int
    base_mode: int
    custom_mode: int
    state: int
    signed: bool = False


@dataclass(frozen=True, slots=True)
class StatusText:
    """The content of a STATUSTEXT, safe to print."""

    system: int
    component: int
    severity: int
    text: str
    signed: bool = False


@dataclass(frozen=True, slots=True)
class TunnelPayload:
    """The content of a TUNNEL. to: MAVLink ids of the receiver; 0: all."""

    system: int
    component: int
    kind: int
    data: bytes
    to: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class RadioStatus:
    """A RADIO_STATUS: signal and noise of a radio and of its other end (`rem...`) in the radio's units, None if unknown; txbuf:
    percent of its transmit buffer that is free."""

    system: int
    component: int
    rssi: int | None
    remrssi: int | None
    noise: int | None
    remnoise: int | None
    txbuf: int


@dataclass(frozen=True, slots=True)
class CommandAck:
    """A COMMAND_ACK. result: MAV_RESULT. to: MAVLink ids of the receiver; (0, 0): not named."""

    system: int
    component: int
    command: int
    result: int
    to: tuple[int, int]
    signed: bool = False


@dataclass(frozen=True, slots=True)
class ComputerStatus:
    """An ONBOARD_COMPUTER_STATUS: CPU and memory in percent, temperature in degrees Celsius; None if unknown."""

    system: int
    component: int
    cpu: int | None
    memory: float | None
    temperature: int | None

    def values(self) -> dict[str, float]:
        """The known values, by name."""
        found = {"cpu": self.cpu, "memory": self.memory, "temperature": self.temperature}
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, slots=True)
class NamedValue:
    """A NAMED_VALUE_FLOAT: of PHM the rate of a topic in Hz. name: safe to print, at most 10 characters; value: None if not finite."""

    system: int
    component: int
    name: str
    value: float | None


Frame = ComputerStatus | NamedValue | Heartbeat | StatusText | TunnelPayload | RadioStatus | CommandAck


def parse(message: Any) -> Frame | None:
    """The data of a decoded pymavlink message; None for a message that is not one of IDS."""
    number, system, component = message.get_msgId(), message.get_srcSystem(), message.get_srcComponent()
    if number == HEARTBEAT:
        return Heartbeat(
            system,
            component,
            message.type,
            message.autopilot,
            message.base_mode,
            message.custom_mode,
            message.system_status,
            bool(message.get_signed()),
        )
    if number == STATUSTEXT:
        return StatusText(
            system, component, message.severity, one_line(_text(message.text))[:MAX_TEXT], bool(message.get_signed())
        )
    if number == TUNNEL:
        data, to = bytes(message.payload[: message.payload_length]), (message.target_system, message.target_component)
        return TunnelPayload(system, component, message.payload_type, data, to)
    if number == RADIO_STATUS:
        levels = (message.rssi, message.remrssi, message.noise, message.remnoise)
        rssi, remrssi, noise, remnoise = (None if level == _UNKNOWN else level for level in levels)
        return RadioStatus(system, component, rssi, remrssi, noise, remnoise, message.txbuf)
    if number == COMMAND_ACK:
        to = (message.target_system, message.target_component)
        return CommandAck(system, component, message.command, message.result, to, bool(message.get_signed()))
    if number == ONBOARD_COMPUTER_STATUS:
        return _computer(system, component, message)
    if number == NAMED_VALUE_FLOAT:
        value = float(message.value)
        return NamedValue(system, component, one_line(_text(message.name)), value if math.isfinite(value) else None)
    return None


def _computer(system: int, component: int, message: Any) -> ComputerStatus:
    cpu, heat = message.cpu_combined[0], message.temperature_core[0]
    used, total = message.ram_usage, message.ram_total
    known = total not in (0, _U32) and used != _U32 and used <= total
    return ComputerStatus(
        system,
        component,
        cpu if cpu <= 100 else None,
        round(100 * used / total, 1) if known else None,
        heat if heat != _NO_HEAT else None,
    )


def result_name(result: int) -> str:
    """``TEMPORARILY_REJECTED``; a number that has no name stays one."""
    return RESULTS[result] if 0 <= result < len(RESULTS) else str(result)


def state_name(state: int | None) -> str:
    """``ACTIVE``; a number that has no name stays one."""
    if state is None:
        return ""
    return STATES[state] if 0 <= state < len(STATES) else str(state)


def _text(text: str | bytes) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else text
