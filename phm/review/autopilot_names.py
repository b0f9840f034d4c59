"""Names of the numbers in an autopilot's record: flight modes, subsystems of errors, reasons of a change of mode."""

from __future__ import annotations

import importlib
from typing import Any

ARDUPILOT, PX4 = 3, 12
"""Values of MAV_AUTOPILOT."""
SUBSYSTEMS = (
    "", "MAIN", "RADIO", "COMPASS", "OPTFLOW", "FAILSAFE_RADIO", "FAILSAFE_BATT", "FAILSAFE_GPS", "FAILSAFE_GCS", "FAILSAFE_FENCE",
    "FLIGHT_MODE", "GPS", "CRASH_CHECK", "FLIP", "AUTOTUNE", "PARACHUTES", "EKFCHECK", "FAILSAFE_EKFINAV", "BARO", "CPU",
    "FAILSAFE_ADSB", "TERRAIN", "NAVIGATION", "FAILSAFE_TERRAIN", "EKF_PRIMARY", "THRUST_LOSS_CHECK", "FAILSAFE_SENSORS",
    "FAILSAFE_LEAK", "PILOT_INPUT", "FAILSAFE_VIBE", "INTERNAL_ERROR", "FAILSAFE_DEADRECKON",
)  # fmt: skip
"""Names of ArduPilot's LogErrorSubsystem, by number."""
REASONS = {
    3: "radio failsafe", 4: "battery failsafe", 5: "GCS failsafe", 6: "EKF failsafe", 7: "GPS glitch", 10: "fence breached",
    11: "terrain failsafe",
}  # fmt: skip
"""ArduPilot's ModeReason: those that no one commanded."""
VEHICLES = {
    "ArduCopter": "COPTER",
    "ArduPlane": "PLANE",
    "ArduRover": "ROVER",
    "ArduSub": "SUB",
    "AntennaTracker": "TRACKER",
}
"""First word of the text with the version of the firmware."""
_TYPES = {1: "PLANE", 10: "ROVER", 11: "ROVER", 12: "SUB", 5: "TRACKER"}
_COPTERS = frozenset((2, 3, 4, 13, 14, 15, 29, 35))
_PX4_NAV = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "AUTO.MISSION", 4: "AUTO.LOITER", 5: "AUTO.RTL", 10: "ACRO", 12: "DESCEND",
    13: "TERMINATION", 14: "OFFBOARD", 15: "STABILIZED", 17: "AUTO.TAKEOFF", 18: "AUTO.LAND", 19: "AUTO.FOLLOW_TARGET",
    20: "AUTO.PRECLAND", 21: "ORBIT", 22: "AUTO.VTOL_TAKEOFF",
}  # fmt: skip
_PX4_MAIN = (
    "",
    "MANUAL",
    "ALTCTL",
    "POSCTL",
    "AUTO",
    "ACRO",
    "OFFBOARD",
    "STABILIZED",
    "RATTITUDE",
    "SIMPLE",
    "TERMINATION",
)
_PX4_AUTO = (
    "",
    "READY",
    "TAKEOFF",
    "LOITER",
    "MISSION",
    "RTL",
    "LAND",
    "",
    "FOLLOW_TARGET",
    "PRECLAND",
    "VTOL_TAKEOFF",
)


def subsystem(number: int) -> str:
    return SUBSYSTEMS[number] if 0 < number < len(SUBSYSTEMS) else f"subsystem {number}"


def is_failsafe(name: str) -> bool:
    return name.startswith("FAILSAFE_") or name == "EKFCHECK"


def vehicle_of(mav_type: int) -> str:
    """MAV_TYPE to the word in the names of the modes; empty: unknown."""
    return "COPTER" if mav_type in _COPTERS else _TYPES.get(mav_type, "")


def ardupilot_mode(vehicle: str, number: int) -> str:
    """``GUIDED``, from the enumeration of the dialect; ``mode 4`` when it is not known there."""
    # Here alone, and only for reports: the dialect takes 5 MB of memory.
    dialect: Any = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    entry = dialect.enums.get(f"{vehicle}_MODE", {}).get(number)
    return str(entry.name).removeprefix(f"{vehicle}_MODE_") if entry is not None else f"mode {number}"


def px4_mode(custom_mode: int) -> str:
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = _PX4_MAIN[main] if main < len(_PX4_MAIN) else ""
    detail = _PX4_AUTO[sub] if name == "AUTO" and sub < len(_PX4_AUTO) else ""
    return f"{name}.{detail}" if detail else name or f"mode {custom_mode}"


def px4_nav_state(number: int) -> str:
    """The name of a value of `vehicle_status.nav_state`."""
    return _PX4_NAV.get(number, f"mode {number}")
