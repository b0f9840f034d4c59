"""Type `serial` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from phm.core.settings.base import Seconds
from phm.core.settings.custom.base import CustomBase


class SerialCheckSettings(CustomBase):
    """A serial port exists, and data arrive on it."""

    type: Literal["serial"]
    """`serial`: a serial port of the host exists and, with `max_age`, data arrive on it."""
    device: Annotated[str, Field(pattern=r"^/dev/.", max_length=4096)]
    """Path on the host, best a stable one such as /dev/serial/by-id/..."""
    max_age: Annotated[Seconds, Field(ge=0.5, le=3600)] | None = None
    """Opt-in: PHM opens the port, reads, and data must arrive at least this often. Only for a port that no other program reads: two
    readers take each other's data. Default: the port is not opened."""
    line: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """A line that must arrive at least every `max_age`, with `*` and `?`, e.g. `$GPGGA,*`. Default: any data."""
    baud: Annotated[int, Field(ge=1200, le=4_000_000)] = 57600
    """Bits per second, while the port is read."""

    @model_validator(mode="after")
    def _reads(self) -> SerialCheckSettings:
        unused = [key for key in ("line", "baud") if key in self.model_fields_set]
        if self.max_age is None and unused:
            raise ValueError(f"has {unused[0]}, which is used only while the port is read: add 'max_age' or remove it")
        return self
