"""Limits of a value, which the types `topic` and `mavlink` share."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from phm.core.settings.custom.base import CustomBase

Number = Annotated[float, Field(allow_inf_nan=False)]
LIMITS = ("min", "max", "warn_min", "warn_max", "equals", "not_nan")


class LimitedCheckSettings(CustomBase):
    """A value and its limits. All that are given must hold."""

    min: Number | None = None
    """Lowest allowed value; default: no limit."""
    max: Number | None = None
    """Highest allowed value; default: no limit."""
    warn_min: Number | None = None
    """WARN below this value; default: no limit."""
    warn_max: Number | None = None
    """WARN above this value; default: no limit."""
    equals: bool | Number | Annotated[str, Field(max_length=100)] | None = None
    """The value that it must have: a number, true, false, or a text. Default: any."""
    not_nan: bool = False
    """True: it must be a number, not NaN. With another limit NaN is never allowed."""

    @property
    def needs_number(self) -> bool:
        """Whether a text cannot meet these limits."""
        limits = (self.min, self.max, self.warn_min, self.warn_max)
        return self.not_nan or any(limit is not None for limit in limits) or isinstance(self.equals, bool | int | float)

    @model_validator(mode="after")
    def _in_order(self) -> LimitedCheckSettings:
        pairs = (("min", "max"), ("warn_min", "warn_max"), ("min", "warn_min"), ("warn_max", "max"))
        for low, high in pairs:
            below, above = getattr(self, low), getattr(self, high)
            if below is not None and above is not None and below > above:
                raise ValueError(f"{low} is {below:g} and {high} is {above:g}: {low} must not be above {high}")
        return self
