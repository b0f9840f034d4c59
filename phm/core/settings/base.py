"""Base of all sections, and the types of their values.

Durations are seconds, sizes bytes, rates hertz, shares percent; the YAML may have a unit (`20s`, `500ms`, `5MB`, `10Hz`, `90%`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

_UNITS: dict[str, dict[str, float]] = {
    "duration": {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "size": {"B": 1, "kB": 1e3, "KB": 1e3, "MB": 1e6, "GB": 1e9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30},
    "rate": {"mHz": 1e-3, "Hz": 1.0, "kHz": 1e3},
    "share": {"%": 1.0},
    "temperature": {"C": 1.0, "°C": 1.0},
}


_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z%°]*)\s*$")


def _quantity(kind: str) -> Callable[[Any], Any]:
    """A validator that turns `20s` into 20.0, or names the allowed units."""
    units = _UNITS[kind]

    def parse(value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"is not a {kind}: write a number, or a number with one of {', '.join(units)}")
        if not isinstance(value, str):
            return value
        match = _QUANTITY.match(value)
        if match is None:
            raise ValueError(f"{value!r} is not a {kind}: write a number, or a number with one of {', '.join(units)}")
        number, unit = match.groups()
        if unit and unit not in units:
            raise ValueError(f"{value!r} has the wrong unit {unit!r} for a {kind}: allowed are {', '.join(units)}")
        return float(number) * (units[unit] if unit else 1.0)

    return parse


def _schema(kind: str) -> WithJsonSchema:
    pattern = rf"^\s*[0-9.eE+-]+\s*({'|'.join(_UNITS[kind])})?\s*$"
    return WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": pattern}]})


Seconds = Annotated[float, BeforeValidator(_quantity("duration")), _schema("duration"), Field(allow_inf_nan=False)]


Bytes = Annotated[float, BeforeValidator(_quantity("size")), _schema("size"), Field(allow_inf_nan=False)]


Hertz = Annotated[float, BeforeValidator(_quantity("rate")), _schema("rate"), Field(allow_inf_nan=False)]


Percent = Annotated[float, BeforeValidator(_quantity("share")), _schema("share"), Field(ge=0, le=100)]


Confidence = Annotated[
    float, BeforeValidator(_quantity("share")), _schema("share"), Field(ge=50, le=99.9, allow_inf_nan=False)
]


Celsius = Annotated[
    float, BeforeValidator(_quantity("temperature")), _schema("temperature"), Field(allow_inf_nan=False)
]


# Docker's rule for names: anything else is a typing mistake.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=128)]


RosName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$", max_length=255)]


AbsolutePath = Annotated[str, Field(pattern=r"^/", max_length=4096)]


def host_and_port(address: str) -> tuple[str, int]:
    """The host and the port of a valid `ListenAddress`."""
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port)


def _with_port(value: str) -> str:
    if not 1 <= host_and_port(value)[1] <= 65535:
        raise ValueError(f"{value!r} has no port from 1 to 65535: expected such as 127.0.0.1:9464")
    return value


ListenAddress = Annotated[
    str,
    Field(pattern=r"^([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$", min_length=3, max_length=300),
    AfterValidator(_with_port),
]


UnexpectedLevel = Literal["off", "warn", "error"]
"""How something that is not in the configuration is reported."""


class Section(BaseModel):
    """Base of all sections: unknown keys are refused, values are not converted, and nothing can be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, str_strip_whitespace=True)


class Limit(Section):
    """A pair of limits; `warn` must not be above `error`."""

    warn: Percent
    """WARN from here."""
    error: Percent
    """ERROR from here."""


class FaultLimit(Section):
    """A pair of limits of a frequency; `warn` must not be above `error`."""

    warn: Annotated[Hertz, Field(gt=0)]
    """WARN from here."""
    error: Annotated[Hertz, Field(gt=0)]
    """ERROR from here."""
