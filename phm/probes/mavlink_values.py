"""Which values of MAVLink fields mean that the sender does not know them. Pure.

By the attribute `invalid` of MAVLink's definitions (common and ardupilotmega of 2026-11), which pymavlink does not keep: nearly all
are the highest value of the type, or NaN. The others that may have limits are in EXCEPTIONS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

HIGHEST: Mapping[str, int] = {
    f"{sign}int{bits}_t": 2 ** (bits - (not sign)) - 1 for sign in ("", "u") for bits in (8, 16, 32, 64)
}
EXCEPTIONS: Mapping[tuple[str, str], float] = {
    ("SYS_STATUS", "current_battery"): -1,
    ("SYS_STATUS", "battery_remaining"): -1,
    ("BATTERY_STATUS", "current_battery"): -1,
    ("BATTERY_STATUS", "current_consumed"): -1,
    ("BATTERY_STATUS", "energy_consumed"): -1,
    ("BATTERY_STATUS", "battery_remaining"): -1,
    ("BATTERY_STATUS", "time_remaining"): 0,
    ("BATTERY_STATUS", "voltages_ext"): 0,
    ("HIGH_LATENCY2", "battery"): -1,
    ("SMART_BATTERY_INFO", "capacity_full_specification"): -1,
    ("SMART_BATTERY_INFO", "capacity_full"): -1,
    ("TIME_ESTIMATE_TO_TARGET", "mission_next_item"): -1,
    ("TIME_ESTIMATE_TO_TARGET", "mission_end"): -1,
    ("TIME_ESTIMATE_TO_TARGET", "commanded_action"): -1,
    ("CONTROL_SYSTEM_STATE", "airspeed"): -1,
    ("HIL_OPTICAL_FLOW", "distance"): -1,
    ("GPS_RAW_INT", "yaw"): 0,
    ("GPS2_RAW", "yaw"): 0,
    ("WIND_COV", "horiz_accuracy"): 0,
    ("WIND_COV", "vert_accuracy"): 0,
    ("DISTANCE_SENSOR", "signal_quality"): 0,
    ("ODOMETRY", "quality"): 0,
    ("CELLULAR_STATUS", "rx_level"): 0,
    ("CELLULAR_STATUS", "sinr"): 0,
}
"""Message, field, and its value that means `not known`."""


def not_known(kind: Any, field: str, value: float) -> bool:
    """Whether this value of a field means that its sender does not know it. kind: pymavlink's class of the message."""
    if math.isnan(value):
        return True
    known = EXCEPTIONS.get((kind.msgname, field))
    if known is not None:
        return value == known
    if kind.fielddisplays_by_name.get(field) == "bitmask":
        return False
    return value == HIGHEST.get(kind.fieldtypes[kind.fieldnames.index(field)])
