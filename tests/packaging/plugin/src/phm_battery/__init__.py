"""A check of a third party."""

from __future__ import annotations

from phm import api


class Battery(api.Check):
    """The battery that feeds the companion computer."""

    name, slot, layer = "battery", api.Slot.USER_1, api.Layer.CUSTOM

    def run(self, world: api.World) -> api.Result:
        return api.ok("battery at 15.2 V", values={"battery_v": 15.2})
