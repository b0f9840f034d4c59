"""Type `process` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import Name
from phm.core.settings.custom.base import CustomBase


class ProcessCheckSettings(CustomBase):
    """As many processes run as expected."""

    type: Literal["process"]
    """`process`: as many processes run as expected."""
    process: Annotated[list[Annotated[str, Field(min_length=1, max_length=255)]], Field(min_length=1, max_length=16)]
    """Words that all occur in the command line of the process."""
    container: Name | None = None
    """Key of the container that is searched; default: all processes visible to PHM; with `pid: host`, all of the host."""
    min_count: Annotated[int, Field(ge=0, le=1000)] = 1
    """Fewest processes."""
    max_count: Annotated[int, Field(ge=0, le=1000)] | None = None
    """Most processes; default: any number."""
