"""Slots 13 to 15: the checks of the section `custom`, which are written in YAML. One class for each type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from phm import api
from phm_checks._custom.base import CustomCheck
from phm_checks._custom.command import Command
from phm_checks._custom.http import Http
from phm_checks._custom.lifecycle import Lifecycle
from phm_checks._custom.log import Log
from phm_checks._custom.mavlink import Mavlink
from phm_checks._custom.process import Process
from phm_checks._custom.serial import Serial
from phm_checks._custom.service import Service
from phm_checks._custom.tcp import Tcp
from phm_checks._custom.topic import Topic

TYPES: Mapping[str, type[CustomCheck]] = {
    "command": Command,
    "http": Http,
    "lifecycle": Lifecycle,
    "log": Log,
    "mavlink": Mavlink,
    "process": Process,
    "serial": Serial,
    "service": Service,
    "tcp": Tcp,
    "topic": Topic,
}


class Custom(api.Check):
    """All entries of `custom`, one instance each."""

    name, slot, layer = "custom", api.Slot.USER_1, api.Layer.CUSTOM

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [TYPES[entry.type](entry, settings) for entry in settings.custom]
