"""What `phm status` and `phm faults` rely on in the status file. Whatever else is in it may be anything."""

from __future__ import annotations

import os
from typing import Any

from phm.wire import status_file
from phm.wire.shape import TableShape, mismatch

_NUMBER = (float, type(None))
_FAULT = {"fault!": str, "unit!": str, "opened!": str, "summary!": str, "blocks!": [str]}
_CLOSED = {**_FAULT, "outcome!": str, "by!": str, "duration_s!": _NUMBER, "brief!": str}
_CHECK = {"slot!": int, "id!": str, "level!": str, "blocked_by!": str, "summary!": str}
_LINK = {
    "name!": str,
    "open!": bool,
    "error!": str,
    "slowed": float,
    "bytes_out": int,
    "sent": TableShape(TableShape(int)),
}
_FLEET = {"fleet!": str, "connected!": bool, "error!": str, "published!": int, "bytes_out!": int}
_CRITICAL = {"containers!": [str], "armed!": str, "why!": str}
_HEALTH = {
    "uptime_s": _NUMBER,
    "late_percent": float,
    "process": TableShape((int, type(None))),
    "links": [_LINK],
    "reporters": {"fleet": _FLEET},
    "dropped": TableShape(int),
    "overdue": [str],
    "problems": [str],
    "flight_critical": _CRITICAL,
}
_HOLD = {"container!": (str, type(None)), "until!": str, "left_s!": float, "by!": str, "reason!": str}
SHAPE = {
    "holds": [_HOLD],
    "checks": [_CHECK],
    "status_array": [(int, type(None))],
    "status_word": int,
    "armed": (bool, type(None)),
    "faults": {"open": [_FAULT], "given_up": [_FAULT], "closed": [_CLOSED]},
    "health": _HEALTH,
}


def read(run_dir: str) -> dict[str, Any]:
    """As `status_file.read`, for a reader that shows what is in it. Raises NoStatus also for a damaged document."""
    document = status_file.read(run_dir)
    wrong = mismatch(document, SHAPE)
    if wrong:
        path = os.path.join(run_dir, status_file.NAME)
        raise status_file.NoStatus(
            f"{path} is damaged ({wrong}): something other than PHM wrote it, or the disk is failing; "
            "a running PHM replaces it within 2 s"
        )
    return document
