"""The clock, on which log times, signed MAVLink messages and the comparison of agents depend."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import datetime, timezone

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, ok
from phm.probes.host import clock_synchronized

FIRST_YEAR = 2025
"""An earlier time is that of a machine without a battery-backed clock."""


def rows(context: DoctorContext) -> Iterator[Row]:
    now = datetime.now(timezone.utc)
    shown = f"{now:%Y-%m-%d %H:%M:%S} UTC"
    synchronized = clock_synchronized()
    remedy = "enable NTP (systemd-timesyncd, chrony) or set the clock from GPS: timedatectl status"
    if now.year < FIRST_YEAR:
        yield limited("time", f"{shown} is wrong", remedy)
    elif synchronized is None:
        yield limited(
            "time", f"{shown}; whether it is synchronized is not known", "timedatectl status on the host shows it"
        )
    elif synchronized:
        yield ok("time", f"{shown}, synchronized")
    else:
        yield limited("time", f"{shown}, not synchronized", remedy)
    boot_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    booted = datetime.fromtimestamp(now.timestamp() - boot_s, timezone.utc)
    yield ok("boot", f"{booted:%Y-%m-%d %H:%M:%S} UTC, {boot_s / 3600:.1f} h ago")
