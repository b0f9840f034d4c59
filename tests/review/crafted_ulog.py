"""A log of PX4, written by the documented format of ULog. It is not a recorded one: this project has none."""

from __future__ import annotations

import struct

SYNC = bytes.fromhex("2f731320250cbb12")
STATUS = "vehicle_status:uint64_t timestamp;uint8_t[3] _other;uint8_t arming_state;uint8_t nav_state;bool failsafe;"
GPS = "sensor_gps:uint64_t timestamp;inner nested;uint64_t time_utc_usec;"
INNER = "inner:float[2] a;uint8_t b;"


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def log(utc_s: float, *, fix: bool = True, system: int = 7) -> bytes:
    """50 s after boot a GPS fix at `utc_s`; armed 60 to 120, a failsafe 90 to 95, texts; boot is 50 s before `utc_s`."""
    key = b"int32_t MAV_SYS_ID"
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    parts += [message("F", each.encode()) for each in (INNER, STATUS, GPS)]
    parts += [message("P", bytes([len(key)]) + key + struct.pack("<i", system))]
    parts += [
        message("A", struct.pack("<BH", 0, 1) + b"vehicle_status"),
        message("A", struct.pack("<BH", 0, 2) + b"sensor_gps"),
    ]
    parts += [status(10, 1, 4), status(20, 1, 4)]
    if fix:
        parts.append(message("D", struct.pack("<HQffBQ", 2, 50_000_000, 1.0, 2.0, 3, int(utc_s * 1e6))))
    parts += [status(60, 2, 4), text(61, 6, "Takeoff detected"), message("S", SYNC), status(80, 2, 14)]
    parts += [text(82, 6, "\x1b[32mReady for takeoff!\x1b[0m\t")]
    parts += [status(90, 2, 5, True), text(90.5, 4, "Failsafe activated"), status(95, 2, 5), status(120, 1, 5)]
    return b"".join(parts)


def status(boot_s: float, arming: int, nav: int, failsafe: bool = False) -> bytes:
    return message("D", struct.pack("<HQ3sBB?", 1, int(boot_s * 1e6), b"xyz", arming, nav, failsafe))


def text(boot_s: float, level: int, words: str) -> bytes:
    return message("L", struct.pack("<BQ", ord("0") + level, int(boot_s * 1e6)) + words.encode())
