"""The MAVLink dialect `common`, wire protocol 2, imported in one place.

Not through `pymavlink.mavutil`: that costs 22 MB more (numpy, a second dialect), prints, and connects
without a deadline.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

# pymavlink reads this when it is imported; without it some versions speak protocol 1.
os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import common as mavlink

if float(mavlink.WIRE_PROTOCOL_VERSION) != 2.0:
    raise ImportError(
        f"pymavlink speaks MAVLink {mavlink.WIRE_PROTOCOL_VERSION}, PHM needs 2.0: it was imported earlier"
    )

RADIO = 166
"""Number of RADIO_STATUS in radios with firmware from before 2014; the fields are the same (dialect ardupilotmega)."""


class _Radio(mavlink.MAVLink_radio_status_message):  # type: ignore[misc]  # pymavlink has no types
    """A RADIO message, treated as RADIO_STATUS."""

    id, msgname, crc_extra = RADIO, "RADIO", 21

    def get_msgId(self) -> int:
        return int(mavlink.MAVLINK_MSG_ID_RADIO_STATUS)


mavlink.mavlink_map[RADIO] = _Radio
SAME = {RADIO: mavlink.MAVLINK_MSG_ID_RADIO_STATUS}
"""Message ids on the wire that mean other ids."""


def message_class(name: str) -> Any | None:
    """The class of a message by its name, of the common dialect, else of ArduPilot's, whose messages are then decoded too; None:
    unknown. ArduPilot's dialect takes 5 MB of memory, so it is imported only for a message of it."""
    found = _by_name(mavlink, name)
    if found is None:
        found = _by_name(importlib.import_module("pymavlink.dialects.v20.ardupilotmega"), name)
        if found is not None:
            found = mavlink.mavlink_map.setdefault(found.id, found)
    return found


def _by_name(dialect: Any, name: str) -> Any | None:
    found = getattr(dialect, f"MAVLink_{name.lower()}_message", None)
    return found if found is not None and getattr(found, "msgname", "") == name else None


__all__ = ["SAME", "mavlink", "message_class"]
