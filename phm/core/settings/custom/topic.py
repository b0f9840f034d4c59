"""Type `topic` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from phm.core.settings.base import Name, RosName, Seconds
from phm.core.settings.custom.limits import LIMITS, LimitedCheckSettings
from phm.core.settings.ros import FieldPath


class TopicCheckSettings(LimitedCheckSettings):
    """A field of a ROS topic is within limits."""

    type: Literal["topic"]
    """`topic`: messages of a ROS topic arrive, and a field of them is within limits."""
    topic: RosName
    """Full name of the topic, e.g. /agent_1/battery."""
    container: Name | None = None
    """The container that it comes from; default: the only configured one."""
    message: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$")] | None = None
    """Type of its messages, e.g. sensor_msgs/msg/BatteryState; with it, the field is checked when the configuration is read, and
    another type is a failure. Default: any."""
    field: FieldPath | None = None
    """The field, e.g. `percentage`, `pose.position.z` or `cells[0].voltage`; of an array of numbers without index, each element
    counts. Default: only `max_age` is checked."""
    max_age: Annotated[Seconds, Field(gt=0, le=3600)] | None = None
    """Longest time since the last message; default: any, but one must have been received."""

    @model_validator(mode="after")
    def _field_and_limits(self) -> TopicCheckSettings:
        given = [key for key in LIMITS if getattr(self, key) not in (None, False) or key in self.model_fields_set]
        if given and self.field is None:
            raise ValueError(f"has {given[0]}, but no field to compare with it: add 'field'")
        if self.field is not None and not given:
            raise ValueError(f"has a field, but no limit for it: add one of {', '.join(LIMITS)}")
        return self
