"""What the types that evaluate the ROS graph share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phm import api
from phm_checks._custom.base import CustomCheck


class RosCheck(CustomCheck):
    """Of the types that evaluate the ROS graph: a change of it wakes them."""

    @property
    def node(self) -> str:
        """Full name of the node that it concerns; empty: not known."""
        return ""

    @property
    def container(self) -> str:
        return self.entry.container or self.settings.container_of_node(self.node)

    @property
    def wakes(self) -> frozenset[str]:
        return super().wakes | {"ros"}

    @property
    def units(self) -> Sequence[api.Unit]:
        """Discovery needs `ros.grace` to fill the graph."""
        (unit,) = super().units
        return (replace(unit, grace_s=max(unit.grace_s, self.settings.ros.grace)),)
