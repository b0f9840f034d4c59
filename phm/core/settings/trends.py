"""Section `trends`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from phm.core.settings.base import Confidence, Seconds, Section

Horizon = Annotated[Seconds, Field(ge=0, le=86_400)]


class TrendSettings(Section):
    """Warnings of what will fail at the present rate. 0 switches one off."""

    disk: Horizon = 1200.0
    """WARN when a disk of `host.disks` will reach `host.disk.error` within this time."""
    memory: Horizon = 600.0
    """WARN when the computer will reach `host.memory.error`, or a container its memory limit, within this time."""
    radio: Horizon = 120.0
    """WARN when the margin of a radio will fall below `mavlink.radio_margin` within this time."""
    jitter: Horizon = 600.0
    """WARN when the jitter of a topic will reach half of its period within this time."""
    restarts: Horizon = 3600.0
    """WARN when the restarts of a container within this time become more frequent."""
    confidence: Confidence = 95.0
    """Share of the forecasts of a steady trend that may not come later than reported."""
