"""Slot 5: devices of the host that are not in the configuration, if `host.unexpected_devices` asks for it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from glob import escape

from phm import api
from phm.api import Slot
from phm_checks._unexpected import unexpected

SETTLE_S = 1.0
"""udev renames devices and changes links within a moment."""


class UnexpectedDevices(api.Check):
    """Devices of the host that are not in the configuration, as one unit. PHM never opens them."""

    name, slot, layer = "unexpected_devices", Slot.DEVICES, api.Layer.DOCKER
    period_s = 10.0
    """Changes of the folders wake the check; the period is for changes that inotify does not report."""

    def __init__(self, settings: api.Settings) -> None:
        self._wanted = settings.host.unexpected_devices
        used = [device.path for entry in settings.containers for device in entry.devices]
        used += [entry.url for entry in settings.mavlink.endpoints if entry.serial]
        used += [entry.device for entry in settings.custom if entry.type == "serial"]
        self._configured = list(dict.fromkeys(used))

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if settings.host.unexpected_devices.level != "off" else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.name, settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"other_device"})

    def run(self, world: api.World) -> api.Result:
        expected = [escape(path) for path in sorted(self._real_paths(world))]
        found = world.devices.matching(self._wanted.watch, without=[*expected, *self._wanted.ignore])
        return unexpected(
            [(fact.path, fact.description) for fact in found],
            level=self._wanted.level,
            noun="device",
            does="exists",
            condition="device_unexpected",
            remedy="unplug them, or add them to `containers[].devices` or host.unexpected_devices.ignore",
            most=api.DeviceFact.MAX_MATCHES,
        )

    def _real_paths(self, world: api.World) -> set[str]:
        """Paths of the configured devices, also those behind links such as /dev/serial/by-id/..."""
        looks = (world.devices.inspect(path, open_it=False) for path in self._configured)
        return {*self._configured, *(fact.path for fact in looks if fact is not None)}
