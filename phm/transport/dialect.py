"""The MAVLink dialect `common`, wire protocol 2, imported in one place.

Not through `pymavlink.mavutil`: that costs 22 MB more (numpy, a second dialect), prints, and connects
without a deadline.
"""

from __future__ import annotations

import os

# pymavlink reads this when it is imported; without it some versions speak protocol 1.
os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import common as mavlink

if float(mavlink.WIRE_PROTOCOL_VERSION) != 2.0:
    raise ImportError(
        f"pymavlink speaks MAVLink {mavlink.WIRE_PROTOCOL_VERSION}, PHM needs 2.0: it was imported earlier"
    )

__all__ = ["mavlink"]
