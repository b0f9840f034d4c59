"""Hosts: names and IP addresses, as far as their form shows whether they can exist."""

from __future__ import annotations

import ipaddress
import re

_NUMBERS = re.compile(r"[0-9]+(\.[0-9]+)+")


def check_host(host: str) -> str:
    """Returns `host`. Raises ValueError for a host with a port, and for numbers with dots that are not an IPv4 address: a resolver
    finds nothing, or completes three numbers to another address."""
    address = host.strip("[]")
    if ":" in address and not _is_address(address, ipaddress.IPv6Address):
        raise ValueError(f"the host {address!r} has ':' and is not an IPv6 address: write the port only once")
    if _NUMBERS.fullmatch(address) and not _is_address(address, ipaddress.IPv4Address):
        raise ValueError(f"the host {address!r} is not an IPv4 address: write four numbers of 0 to 255")
    return host


def _is_address(text: str, family: type[ipaddress.IPv4Address | ipaddress.IPv6Address]) -> bool:
    try:
        family(text)
    except ValueError:
        return False
    return True
