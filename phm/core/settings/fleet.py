"""Section `fleet`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import AbsolutePath, Name, Seconds, Section

FleetEndpoint = Annotated[
    str, Field(pattern=r"^(tcp|tls|quic)/([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$", max_length=300)
]


class FleetTlsSettings(Section):
    """Certificates for endpoints `tls/` and `quic/`, as files in PEM."""

    ca: AbsolutePath | None = None
    """CA certificate that signed the routers' certificates; default: the system's trusted CAs."""
    certificate: AbsolutePath | None = None
    """This agent's client certificate, for routers that require one."""
    key: AbsolutePath | None = None
    """The private key of `certificate`."""
    verify_name: bool = True
    """Whether a router's certificate must be for the host in `connect`."""


class FleetSettings(Section):
    """The same status over Zenoh, for fleets on IP; needs the extra `fleet`."""

    enabled: bool = False
    """True: the status is published."""
    name: Name = "fleet"
    """Name of the fleet; the second part of each Zenoh key."""
    mode: Literal["client", "peer"] = "client"
    """`client`: through a router; `peer`: also directly to other peers."""
    connect: Annotated[list[FleetEndpoint], Field(max_length=16)] = Field(default_factory=list)
    """Routers (or peers): tcp/HOST:PORT, tls/HOST:PORT, quic/HOST:PORT. A client uses the first that answers."""
    listen: Annotated[list[FleetEndpoint], Field(max_length=4)] = Field(default_factory=list)
    """Where a peer takes connections, e.g. tcp/0.0.0.0:7447."""
    refresh: Annotated[Seconds, Field(ge=1, le=3600)] = 10.0
    """Seconds after which an unchanged status is published again."""
    deadline: Annotated[Seconds, Field(ge=0.5, le=60)] = 5.0
    """Limit of each attempt to connect, for each endpoint; a fleet that is unreachable for two of these is reported."""
    lease: Annotated[Seconds, Field(ge=1, le=300)] = 10.0
    """A connection that is silent for this long counts as lost at both ends, and so does the agent behind it."""
    tls: FleetTlsSettings = FleetTlsSettings()
    """Certificates."""
