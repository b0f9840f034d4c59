"""Type `lifecycle` of the section `custom`."""

from __future__ import annotations

from typing import Literal

from phm.core.settings.base import Name, RosName
from phm.core.settings.custom.base import CustomBase


class LifecycleCheckSettings(CustomBase):
    """A ROS 2 lifecycle node is in a state."""

    type: Literal["lifecycle"]
    """`lifecycle`: a ROS 2 lifecycle node is in the expected state."""
    node: RosName
    """Full name of the node, e.g. /agent_1/planner."""
    container: Name | None = None
    """The container that it runs in; default: that of the node in `ros.nodes`, else the only configured one."""
    state: Literal["unconfigured", "inactive", "active", "finalized"] = "active"
    """The state that it must be in."""
