"""The section `metrics`: measurements for Prometheus."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import Field, field_validator

from phm.core.settings.base import Section

ListenAddress = Annotated[
    str, Field(pattern=r"^([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$", min_length=3, max_length=300)
]


class MetricsSettings(Section):
    """Measurements for Prometheus, over HTTP; needs the extra `metrics`."""

    listen: ListenAddress | None = None
    """Address and port of the page /metrics, e.g. 127.0.0.1:9464. Any program that reaches another address than loopback can read it."""

    @field_validator("listen")
    @classmethod
    def _port(cls, value: str | None) -> str | None:
        if value is not None and not 1 <= int(value.rpartition(":")[2]) <= 65535:
            raise ValueError(f"{value!r} has no port from 1 to 65535: expected such as 127.0.0.1:9464")
        return value

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `listen`, which must be set."""
        host, _, port = (self.listen or "").rpartition(":")
        return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach this address; False for a name other than localhost."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
