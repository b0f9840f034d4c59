"""Type `mavlink` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from phm.core.settings.base import Hertz, Seconds
from phm.core.settings.custom.limits import LIMITS, LimitedCheckSettings


class MavlinkCheckSettings(LimitedCheckSettings):
    """A field of a MAVLink message from the autopilot is within limits."""

    type: Literal["mavlink"]
    """`mavlink`: a MAVLink message of this vehicle arrives, and a field of it is within limits."""
    message: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$", max_length=60)]
    """Name of the message, e.g. BATTERY_STATUS, EKF_STATUS_REPORT or GPS_RAW_INT."""
    field: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\[\d{1,3}\])?$", max_length=60)]
    """The field, e.g. `battery_remaining` or `voltages[0]`, in the unit of the message."""
    instance: Annotated[int, Field(ge=0, le=255)] | None = None
    """Which of several, where the message has a field for it (`id` of BATTERY_STATUS); default: each counts."""
    component: Annotated[int, Field(ge=1, le=255)] = 1
    """MAVLink component id of the sender, on this vehicle; 1 is the autopilot."""
    max_age: Annotated[Seconds, Field(gt=0, le=3600)] = 10.0
    """Longest time since the last message."""
    request: Annotated[Hertz, Field(gt=0, le=10)] | None = None
    """Opt-in: PHM requests the message at this rate (MAV_CMD_SET_MESSAGE_INTERVAL) while it does not arrive. Default: PHM sends
    no commands to the autopilot."""

    @model_validator(mode="after")
    def _has_limit(self) -> MavlinkCheckSettings:
        if not any(getattr(self, key) not in (None, False) or key in self.model_fields_set for key in LIMITS):
            raise ValueError(f"has no limit for its field: add one of {', '.join(LIMITS)}")
        return self
