"""Which values of MAVLink fields mean that the sender does not know them. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

NUMBERS: Mapping[str, int] = {
    "UINT8_MAX": 2**8 - 1,
    "UINT16_MAX": 2**16 - 1,
    "UINT32_MAX": 2**32 - 1,
    "INT8_MAX": 2**7 - 1,
    "INT16_MAX": 2**15 - 1,
    "INT32_MAX": 2**31 - 1,
}
# The attribute `invalid` of MAVLink's definitions (common and ardupilotmega, 2026-11), which pymavlink does not keep. Messages that
# an autopilot only receives are left out. Not all fields have such a value: 65535 of MEMINFO.freemem is a lot of memory.
TABLE = """
AIRSPEED INT16_MAX: temperature
BATTERY_STATUS INT16_MAX: temperature
BATTERY_STATUS UINT16_MAX: voltages
BATTERY_STATUS -1: current_battery current_consumed energy_consumed battery_remaining
BATTERY_STATUS 0: time_remaining voltages_ext
CONTROL_SYSTEM_STATE -1: airspeed
DISTANCE_SENSOR UINT8_MAX: covariance
DISTANCE_SENSOR 0: horizontal_fov vertical_fov quaternion signal_quality
GENERATOR_STATUS UINT16_MAX: generator_speed
GENERATOR_STATUS INT16_MAX: rectifier_temperature generator_temperature
GENERATOR_STATUS UINT32_MAX: runtime
GENERATOR_STATUS INT32_MAX: time_until_maintenance
GLOBAL_POSITION_INT UINT16_MAX: hdg
GLOBAL_POSITION_SENSOR INT32_MAX: lat lon
GPS2_RAW UINT16_MAX: eph epv vel cog
GPS2_RAW UINT8_MAX: satellites_visible
GPS2_RAW 0: yaw
GPS_RAW_INT UINT16_MAX: eph epv vel cog
GPS_RAW_INT UINT8_MAX: satellites_visible
GPS_RAW_INT 0: yaw
HIGH_LATENCY UINT8_MAX: gps_nsat
HIGH_LATENCY2 -1: battery
OBSTACLE_DISTANCE UINT16_MAX: distances
ODOMETRY 0: quality
ONBOARD_COMPUTER_STATUS UINT8_MAX: cpu_cores cpu_combined gpu_cores gpu_combined
ONBOARD_COMPUTER_STATUS INT8_MAX: temperature_board temperature_core
ONBOARD_COMPUTER_STATUS INT16_MAX: fan_speed
ONBOARD_COMPUTER_STATUS UINT32_MAX: ram_usage ram_total storage_type storage_usage storage_total link_tx_rate
ONBOARD_COMPUTER_STATUS UINT32_MAX: link_rx_rate link_tx_max link_rx_max
RAW_PRESSURE 0: press_diff1 press_diff2
RC_CHANNELS UINT16_MAX: chan1_raw chan2_raw chan3_raw chan4_raw chan5_raw chan6_raw chan7_raw chan8_raw chan9_raw
RC_CHANNELS UINT16_MAX: chan10_raw chan11_raw chan12_raw chan13_raw chan14_raw chan15_raw chan16_raw chan17_raw
RC_CHANNELS UINT16_MAX: chan18_raw
RC_CHANNELS UINT8_MAX: rssi
RC_CHANNELS_RAW UINT16_MAX: chan1_raw chan2_raw chan3_raw chan4_raw chan5_raw chan6_raw chan7_raw chan8_raw
RC_CHANNELS_RAW UINT8_MAX: rssi
RC_CHANNELS_SCALED INT16_MAX: chan1_scaled chan2_scaled chan3_scaled chan4_scaled chan5_scaled chan6_scaled
RC_CHANNELS_SCALED INT16_MAX: chan7_scaled chan8_scaled
RC_CHANNELS_SCALED UINT8_MAX: rssi
SCALED_IMU2 0: temperature
SCALED_IMU3 0: temperature
SCALED_PRESSURE 0: temperature_press_diff
SCALED_PRESSURE2 0: temperature_press_diff
SCALED_PRESSURE3 0: temperature_press_diff
SMART_BATTERY_INFO -1: capacity_full_specification capacity_full
SMART_BATTERY_INFO UINT16_MAX: cycle_count discharge_minimum_voltage charging_minimum_voltage
SMART_BATTERY_INFO UINT16_MAX: resting_minimum_voltage
SMART_BATTERY_INFO 0: weight charging_maximum_voltage cells_in_series discharge_maximum_current
SMART_BATTERY_INFO 0: discharge_maximum_burst_current
SYS_STATUS UINT16_MAX: voltage_battery
SYS_STATUS -1: current_battery battery_remaining
WINCH_STATUS INT16_MAX: temperature
WIND_COV 0: horiz_accuracy vert_accuracy
"""


def _table(text: str) -> Mapping[tuple[str, str], int]:
    found = {}
    for line in text.strip().splitlines():
        head, _, fields = line.partition(":")
        message, value = head.split()
        for field in fields.split():
            found[message, field] = NUMBERS[value] if value in NUMBERS else int(value)
    return found


INVALID = _table(TABLE)
"""Message and field, and its value that means `not known`."""


def not_known(message: str, field: str, value: float) -> bool:
    """Whether this value of a field means that its sender does not know it. NaN always does."""
    return math.isnan(value) or INVALID.get((message, field)) == value
