"""Type `log` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import AbsolutePath, Name, Seconds, Section
from phm.core.settings.custom.base import CustomBase, Pattern


class LogPatternSettings(Section):
    """One pattern and its level."""

    pattern: Pattern
    """Regular expression that is searched in each new line."""
    level: Literal["warn", "error"] = "error"
    """Level while it has been found."""


class LogCheckSettings(CustomBase):
    """New lines of a log do not match a pattern."""

    type: Literal["log"]
    """`log`: new lines of a log match none of the patterns."""
    path: AbsolutePath | None = None
    """The log file as PHM's container sees it. Give this or `container`."""
    container: Name | None = None
    """Key of the container whose Docker log is read."""
    patterns: Annotated[list[LogPatternSettings], Field(min_length=1, max_length=16)]
    """What is searched."""
    quiet: Annotated[Seconds, Field(ge=1, le=86400)] = 60.0
    """The failure is over when the pattern was not found for this long."""
