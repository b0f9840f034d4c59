"""Which network PHM is in: its own, as in a bridged container, or that of the host."""

from __future__ import annotations

import os

_MARKS = ("/.dockerenv", "/run/.containerenv")
"""Docker and Podman create these files in each container."""
_NET = "/sys/class/net"


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
    return scheme in ("udpout", "tcp") and (host in ("localhost", "::1") or host.startswith("127."))


def _number(net: str, name: str, attribute: str) -> int:
    with open(os.path.join(net, name, attribute), encoding="ascii") as stream:
        return int(stream.read())
