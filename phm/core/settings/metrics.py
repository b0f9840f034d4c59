"""The section `metrics`: measurements for Prometheus."""

from __future__ import annotations

import ipaddress

from phm.core.settings.base import ListenAddress, Section, host_and_port


class MetricsSettings(Section):
    """Measurements for Prometheus, over HTTP; needs the extra `metrics`."""

    listen: ListenAddress | None = None
    """Address and port of the page /metrics, e.g. 127.0.0.1:9464. Any program that reaches another address than loopback can read it."""

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `listen`, which must be set."""
        return host_and_port(self.listen or "")


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach this address; False for a name other than localhost."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
