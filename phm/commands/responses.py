"""The MAVLink messages that answer a command, from published results: nothing is measured for them."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Sequence
from typing import Any

from phm.core.model import Fault, UnitState, worst_by_slot
from phm.transport.dialect import mavlink
from phm.wire import status_line, status_word, tunnel
from phm.wire.command import CONTAINERS_TEXT, HEARTBEAT, STATUSTEXT, Command, CommandResult, fault_number
from phm.wire.status_line import Severity

_U8, _I8, _I16, _U32 = 0xFF, 0x7F, 0x7FFF, 0xFFFFFFFF
"""The standard's value for `unknown` in a field of that type."""
_MIB = 2**20
MOST_OTHERS = 20
MOST_RATES, NAME_BYTES = 32, 10
"""Of NAMED_VALUE_FLOAT: messages of one answer, and size of the field `name`."""


def ack(command: Command, result: CommandResult) -> Any:
    """Send a COMMAND_ACK to the sender."""
    return mavlink.MAVLink_command_ack_message(command.command, int(result), 0, 0, command.system, command.component)


def status(message: int, agent: int, states: Sequence[UnitState], *, complete: bool, mono: float, utc: float) -> Any:
    """HEARTBEAT, STATUSTEXT or ONBOARD_COMPUTER_STATUS. complete: a first report is done; mono, utc: seconds."""
    if message == HEARTBEAT:
        kind, autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        word = status_word.encode(worst_by_slot(tuple(states)))
        return mavlink.MAVLink_heartbeat_message(
            kind, autopilot, 0, word, status_word.system_status(states, complete=complete), 3
        )
    if message == STATUSTEXT:
        line = status_line.refresh(agent, states)
        return mavlink.MAVLink_statustext_message(int(Severity.INFO), line.encode("ascii"))
    return computer(states, mono=mono, utc=utc)


def computer(states: Sequence[UnitState], *, mono: float, utc: float) -> Any:
    """ONBOARD_COMPUTER_STATUS with what the host check found last; what it does not report is marked as unknown."""
    found = [state.result.readings for state in states if state.result.readings is not None]
    cpu = next((one.cpu_percent for one in found if one.cpu_percent is not None), None)
    heat = next((one.temperature_c for one in found if one.temperature_c is not None), None)
    memory = next((one.memory_percent for one in found if one.memory_percent is not None), None)
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if memory is not None else None
    disks = [disk for one in found for disk in one.disks]
    fans = [_within(rpm, 0, _I16 - 1) for one in found for rpm in one.fans_rpm]
    return mavlink.MAVLink_onboard_computer_status_message(
        time_usec=int(max(0.0, utc) * 1e6),
        uptime=int(max(0.0, mono) * 1e3) & _U32,
        type=0,
        cpu_cores=[_U8] * 8,
        cpu_combined=[_U8 if cpu is None else _within(cpu, 0, 100), *[_U8] * 9],
        gpu_cores=[_U8] * 4,
        gpu_combined=[_U8] * 10,
        temperature_board=_I8,
        temperature_core=[_I8 if heat is None else _within(heat, -127, 126), *[_I8] * 7],
        fan_speed=_four(fans, _I16),
        ram_usage=_U32 if memory is None or total is None else round(total * memory / 100 / _MIB),
        ram_total=_U32 if total is None else round(total / _MIB),
        storage_type=[_U32] * 4,
        storage_usage=_four([round((total - free) / _MIB) for total, free in disks], _U32),
        storage_total=_four([round(total / _MIB) for total, _ in disks], _U32),
        link_type=[_U32] * 6,
        link_tx_rate=[_U32] * 6,
        link_rx_rate=[_U32] * 6,
        link_tx_max=[_U32] * 6,
        link_rx_max=[_U32] * 6,
    )


def rates(states: Sequence[UnitState], *, mono: float) -> list[Any]:
    """NAMED_VALUE_FLOAT messages with the measured rates of topics in Hz, in the order of the configuration; at most MOST_RATES."""
    known = [(state.unit, state.result.rate_hz) for state in states if state.result.rate_hz is not None]
    named = zip(short_names([unit for unit, _ in known]), known, strict=True)
    boot_ms = int(max(0.0, mono) * 1e3) & _U32
    return [
        mavlink.MAVLink_named_value_float_message(boot_ms, name.encode("ascii"), float(hz or 0.0))
        for name, (_, hz) in itertools.islice(named, MOST_RATES)
    ]


def short_names(units: Sequence[str]) -> list[str]:
    """The last part of each name in at most NAME_BYTES printable ASCII characters, shortened in the middle. Equal ones get a number:
    a ground station keeps one value for each name."""
    found: list[str] = []
    for unit in units:
        name = status_line.shortened(unit.rpartition("/")[2], NAME_BYTES)
        again = 1
        while name in found:
            again += 1
            name = f"{name[: NAME_BYTES - 1 - len(str(again))]}~{again}"
        found.append(name)
    return found


def _four(known: Sequence[int], unknown: int) -> list[int]:
    """The first four known values; missing ones are `unknown`."""
    return [*(min(value, unknown) for value in known[:4]), *[unknown] * (4 - len(known[:4]))]


def details(fault: Fault, command: Command, others: Sequence[str] = ()) -> list[Any]:
    """TUNNEL messages with the text about a fault, to the sender. others: ids of further open faults."""
    since = time.strftime("%H:%M:%S", time.gmtime(max(0.0, min(fault.opened.utc, 1e11))))
    pieces = [f"{fault.unit}: {fault.result.summary}", f"{fault.outcome.value} since {since} UTC"]
    if fault.consequences:
        pieces.append(f"blocks {', '.join(fault.consequences)}")
    if fault.suspects:
        pieces.append(f"possible cause: {', '.join(fault.suspects)}")
    numbers = [number for other in others if (number := fault_number(other)) is not None]
    if numbers:
        pieces.append(f"other open faults: {', '.join(map(str, numbers[:MOST_OTHERS]))}")
    return text(fault.id, "; ".join(pieces), command)


def containers(names: Sequence[str], command: Command) -> list[Any]:
    """TUNNEL messages with the names of the containers and their positions in the configuration, to the sender."""
    return text(CONTAINERS_TEXT, ", ".join(f"{place} {name}" for place, name in enumerate(names, 1)), command)


def text(about: str, words: str, command: Command) -> list[Any]:
    """TUNNEL messages with a text to the sender of a command. about: a fault's id, CONTAINERS_TEXT or REPLY_TEXT."""
    payloads = [tunnel.encode(part) for part in tunnel.details(about, words)]
    return [
        mavlink.MAVLink_tunnel_message(
            command.system,
            command.component,
            tunnel.PAYLOAD_TYPE,
            len(payload),
            list(payload.ljust(tunnel.MAX_BYTES, b"\0")),
        )
        for payload in payloads
    ]


def _within(value: float, least: int, most: int) -> int:
    return min(max(round(value), least), most)
