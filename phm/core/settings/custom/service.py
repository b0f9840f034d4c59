"""Type `service` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import Name, RosName
from phm.core.settings.custom.base import CustomBase


class ServiceCheckSettings(CustomBase):
    """A ROS service has a server, and answers."""

    type: Literal["service"]
    """`service`: a ROS service has a server and, with `call`, answers."""
    service: RosName
    """Full name of the service, e.g. /agent_1/is_ready."""
    container: Name | None = None
    """The container that offers it; default: the only configured one."""
    call: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/srv/[A-Z][A-Za-z0-9]*$")] | None = None
    """Opt-in: PHM calls the service every `period`. Its type, whose request has no fields: std_srvs/srv/Trigger,
    std_srvs/srv/Empty, or one of the application. It must answer within `timeout`, and with `success: true` if the response
    has this field. A call has whatever effect the service has. Default: it is not called."""
