"""Runs in .venv-interop: connects with MAVSDK as a ground station, prints received data as JSON lines, and sends each
line of its standard input (`COMPONENT COMMAND PARAM1 PARAM2`) as COMMAND_LONG.

``python mavsdk_watch.py tcpout://127.0.0.1:5760 [URL...]``
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.telemetry import Telemetry

FOUND_LIMIT_S = 120.0
SHOWN = ("HEARTBEAT", "STATUSTEXT", "COMMAND_ACK", "TUNNEL", "ONBOARD_COMPUTER_STATUS")
_print = threading.Lock()


def emit(kind: str, **more: Any) -> None:
    with _print:
        sys.stdout.write(json.dumps({"kind": kind, **more}) + "\n")
        sys.stdout.flush()


def message(received: MavlinkMessage, _: Any) -> None:
    emit(
        "message",
        name=received.message_name,
        system=received.system_id,
        component=received.component_id,
        fields=json.loads(received.fields_json),
    )


def main(urls: list[str]) -> None:
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    for url in urls:
        result = sdk.add_any_connection(url)
        if result != ConnectionResult.SUCCESS:
            sys.exit(f"MAVSDK cannot connect to {url}: {result.name}")
    system = sdk.first_autopilot(FOUND_LIMIT_S)
    if system is None:
        sys.exit(f"MAVSDK saw no autopilot within {FOUND_LIMIT_S:g} s")
    telemetry, direct = Telemetry(system), MavlinkDirect(system)
    system.subscribe_is_connected(lambda connected, _: emit("connected", value=connected))
    telemetry.subscribe_status_text(lambda text, _: emit("text", severity=text.type.name, text=text.text))
    telemetry.subscribe_armed(lambda armed, _: emit("armed", value=bool(armed)))
    for name in SHOWN:
        direct.subscribe_message(name, message)

    def look() -> None:
        emit(
            "system",
            count=sdk.system_count(),
            id=system.get_system_id(),
            components=sorted(system.component_ids()),
            autopilot=system.has_autopilot(),
            kind_of=system.autopilot_type().name,
            vehicle=system.vehicle_type().name,
            connected=system.is_connected(),
        )

    emit("ready", version=sdk.version())
    look()
    for line in sys.stdin:
        if line.strip() == "look":
            look()
            continue
        component, command, first, second = (int(word) for word in line.split())
        fields = {
            "target_system": system.get_system_id(),
            "target_component": component,
            "command": command,
            "confirmation": 0,
            "param1": first,
            "param2": second,
            "param3": 0,
            "param4": 0,
            "param5": 0,
            "param6": 0,
            "param7": 0,
        }
        direct.send_message(MavlinkMessage("COMMAND_LONG", 0, 0, system.get_system_id(), component, json.dumps(fields)))


if __name__ == "__main__":
    main(sys.argv[1:])
