"""Type `tcp` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.custom.base import CustomBase, HostName


class TcpCheckSettings(CustomBase):
    """A TCP server accepts connections."""

    type: Literal["tcp"]
    """`tcp`: a TCP server accepts connections."""
    host: HostName
    """Name or IP address of the server, as PHM's container reaches it."""
    port: Annotated[int, Field(ge=1, le=65535)]
    """Port of the server."""
    expect: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Text that the server must send first, e.g. `SSH-2.0`; default: the connection suffices."""
