"""Section `custom`: checks that are written in YAML, one class for each `type`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from phm.core.settings.custom.base import CustomBase, CustomRecoverySettings
from phm.core.settings.custom.http import HttpCheckSettings
from phm.core.settings.custom.tcp import TcpCheckSettings

__all__ = ["CustomBase", "CustomCheckSettings", "CustomRecoverySettings", "HttpCheckSettings", "TcpCheckSettings"]

CustomCheckSettings = Annotated[HttpCheckSettings | TcpCheckSettings, Field(discriminator="type")]
"""One entry of `custom`; its key `type` decides which keys it has."""
