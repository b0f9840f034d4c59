"""Values of fields of MAVLink messages. Part of `phm.facts`; import them from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class MessageValue:
    """One field of the newest message of one instance, e.g. of one battery."""

    age_s: float
    """Since it was received, in monotonic seconds before the call."""
    number: float | None = None
    """None: the field is a text, or the value is not known."""
    text: str = ""
    """The text of a text field; of a value that is not known, the number that says so."""
    unknown: bool = False
    """Whether the sender reports that it does not know the value, by MAVLink's rules, e.g. -1 or UINT16_MAX."""
    unit: str = ""
    """As in MAVLink's definition, e.g. `mV`; empty: none."""
    instance: int | None = None
    """Which of several; None: the message has no field for it."""
    link: str = ""
    """Name of the endpoint that received it."""
    not_counted_s: float = 0.0
    """The part of age_s in which PHM did not run or had not read its link."""

    @property
    def silent_s(self) -> float:
        """The part of its age that counts as silence."""
        return max(0.0, self.age_s - self.not_counted_s)


class MessageProbe(Protocol):
    """Reads fields of MAVLink messages that were received."""

    def values(self, message: str, field: str, *, component: int, instance: int | None) -> Sequence[MessageValue]:
        """Return the field `name` or `name[0]` for each instance that was received, or for the one named. Only of messages
        that own checks name, on links that lead to the autopilot, from this vehicle. Empty: none was received."""
