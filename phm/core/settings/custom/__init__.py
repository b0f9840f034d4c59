"""Section `custom`: checks that are written in YAML, one class for each `type`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from phm.core.settings.custom.base import CustomBase, CustomRecoverySettings
from phm.core.settings.custom.command import CommandCheckSettings
from phm.core.settings.custom.http import HttpCheckSettings
from phm.core.settings.custom.lifecycle import LifecycleCheckSettings
from phm.core.settings.custom.limits import LimitedCheckSettings
from phm.core.settings.custom.log import LogCheckSettings
from phm.core.settings.custom.mavlink import MavlinkCheckSettings
from phm.core.settings.custom.process import ProcessCheckSettings
from phm.core.settings.custom.serial import SerialCheckSettings
from phm.core.settings.custom.service import ServiceCheckSettings
from phm.core.settings.custom.tcp import TcpCheckSettings
from phm.core.settings.custom.topic import TopicCheckSettings

__all__ = [
    "CommandCheckSettings",
    "CustomBase",
    "CustomCheckSettings",
    "CustomRecoverySettings",
    "HttpCheckSettings",
    "LifecycleCheckSettings",
    "LimitedCheckSettings",
    "LogCheckSettings",
    "MavlinkCheckSettings",
    "ProcessCheckSettings",
    "SerialCheckSettings",
    "ServiceCheckSettings",
    "TcpCheckSettings",
    "TopicCheckSettings",
]

CustomCheckSettings = Annotated[
    CommandCheckSettings
    | HttpCheckSettings
    | LifecycleCheckSettings
    | LogCheckSettings
    | MavlinkCheckSettings
    | ProcessCheckSettings
    | SerialCheckSettings
    | ServiceCheckSettings
    | TcpCheckSettings
    | TopicCheckSettings,
    Field(discriminator="type"),
]
"""One entry of `custom`; its key `type` decides which keys it has."""
