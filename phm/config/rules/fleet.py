"""Rules between the keys of `fleet`."""

from __future__ import annotations

from importlib.util import find_spec

from phm.config.node import ConfigNode
from phm.core.extras import remedy

_ENCRYPTED = ("tls/", "quic/")


def fleet_has_endpoints(root: ConfigNode) -> None:
    """When enabled: its package is installed, and it has an endpoint."""
    fleet = root.get("fleet")
    enabled = fleet.get("enabled")
    if enabled.value is not True:
        return
    if find_spec("zenoh") is None:
        enabled.add_problem(
            f"is true, but eclipse-zenoh is not installed: {remedy('fleet')}, or build the image with EXTRAS=fleet"
        )
    if not fleet.get("connect").texts and not fleet.get("listen").texts:
        enabled.add_problem(
            "is true, but neither 'connect' nor 'listen' is given: name a router, e.g. connect: [tcp/HOST:7447]"
        )


def fleet_modes_match(root: ConfigNode) -> None:
    fleet = root.get("fleet")
    if fleet.get("listen").texts and fleet.get("mode").text in ("", "client"):
        fleet.get("listen").add_problem("a client does not accept connections: set 'mode: peer', or remove this key")
    for key in ("connect", "listen"):
        for endpoint in fleet.get(key).texts:
            port = endpoint.text.rpartition(":")[2]
            if port.isdecimal() and not 1 <= int(port) <= 65535:
                endpoint.add_problem(f"{endpoint.text!r} needs a port from 1 to 65535")


def fleet_certificates_are_used(root: ConfigNode) -> None:
    """Half a pair, or certificates for unencrypted connections, would suggest a protection that does not exist."""
    fleet = root.get("fleet")
    tls = fleet.get("tls")
    pair = (tls.get("certificate"), tls.get("key"))
    for one, other in (pair, pair[::-1]):
        if one.given and not other.given:
            one.add_problem(f"requires {other.path[-1]!r}, too")
    endpoints = [endpoint.text for key in ("connect", "listen") for endpoint in fleet.get(key).texts]
    files = [tls.get(key) for key in ("ca", "certificate", "key") if tls.get(key).given]
    if files and endpoints and not any(endpoint.startswith(_ENCRYPTED) for endpoint in endpoints):
        files[0].add_problem("is given, but no endpoint is encrypted: write tls/HOST:PORT, or remove the files")
