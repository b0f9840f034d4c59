"""Key `ready` of containers and nodes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import RosName, Seconds, Section


class ReadySettings(Section):
    """What a running container or node must provide to be ready for its task."""

    topics: Annotated[list[RosName], Field(max_length=32)] = Field(default_factory=list)
    """Topics on which messages must arrive; a latched one must have been published. Not those of `ros.topics`."""
    silence: Annotated[Seconds, Field(gt=0, le=600)] | None = None
    """Longest time between two messages on each of these topics; default: `ros.silence`."""
    services: Annotated[list[RosName], Field(max_length=32)] = Field(default_factory=list)
    """Services that must have a server. They are not called."""
    call: RosName | None = None
    """Service of type std_srvs/srv/Trigger that must answer `success: true`. PHM calls it every two seconds; default: none."""
    within: Annotated[Seconds, Field(ge=0, le=600)] = 30.0
    """Seconds after a start in which it may become ready; at most `recovery.verify`."""
    level: Literal["error", "warn"] = "error"
    """Level while it is not ready. `warn` opens no fault, so nothing is restarted."""


class NodeReadySettings(ReadySettings):
    """The same for a node, which may be a lifecycle node."""

    lifecycle: Literal["unconfigured", "inactive", "active"] | None = None
    """The state that the ROS 2 lifecycle node must be in; default: not checked."""
