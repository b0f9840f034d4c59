"""Which network PHM is in: its own, as in a bridged container, or that of the host; and where the host is there."""

from __future__ import annotations

import os
import socket
import struct

HOST_NAME = "host.docker.internal"
"""The host, as compose files name it for a bridged container: `host-gateway`, its address on Docker's default bridge."""

_MARKS = ("/.dockerenv", "/run/.containerenv")
"""Docker and Podman create these files in each container."""
_NET = "/sys/class/net"
_ROUTES = "/proc/net/route"
_HAS_GATEWAY = 2


def is_private(net: str = _NET, marks: tuple[str, ...] = _MARKS) -> bool:
    """Whether PHM runs in a container with its own network namespace, where 127.0.0.1 is not the host.

    There, every interface but `lo` is one end of a pair (its peer, `iflink`, is another interface); the host also has real
    ones. A namespace that is shared with another container counts as private.
    """
    if not any(os.path.exists(mark) for mark in marks):
        return False
    try:
        names = [name for name in os.listdir(net) if name != "lo"]
        return all(_number(net, name, "iflink") != _number(net, name, "ifindex") for name in names)
    except (OSError, ValueError):
        return False


def is_loopback(url: str) -> bool:
    """Whether frames of this endpoint stay within PHM's own network namespace. PHM waits for peers at `udpin` and `tcpin`."""
    scheme, _, rest = url.partition(":")
    host = rest.rpartition(":")[0].strip("[]").lower()
    return scheme in ("udpout", "tcp") and _is_own(host)


def listens_only_inside(url: str) -> bool:
    """Whether PHM waits at loopback: what is sent to its container does not arrive there, through a published port neither."""
    scheme, _, rest = url.partition(":")
    host = rest.rpartition(":")[0].strip("[]").lower()
    return scheme in ("udpin", "tcpin") and _is_own(host)


def _is_own(host: str) -> bool:
    return host in ("localhost", "::1") or host.startswith("127.")


def gateway(routes: str = _ROUTES) -> str:
    """IPv4 address of the default gateway, empty without one. For a bridged container it is the host, at the host's address on
    the container's network."""
    try:
        with open(routes, encoding="ascii") as stream:
            rows = [line.split() for line in stream][1:]
        found = [(int(row[6]), int(row[2], 16)) for row in rows if row[1] == "0" * 8 and int(row[3], 16) & _HAS_GATEWAY]
    except (OSError, ValueError, IndexError):
        return ""
    return socket.inet_ntoa(struct.pack("=I", min(found)[1])) if found else ""


def _number(net: str, name: str, attribute: str) -> int:
    with open(os.path.join(net, name, attribute), encoding="ascii") as stream:
        return int(stream.read())
