"""What all checks of the section `custom` have in common."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from phm.core.settings.base import Name, Seconds, Section
from phm.core.settings.hosts import check_host

Word = Annotated[str, Field(min_length=1, max_length=4096)]
"""One word of a command."""
Pattern = Annotated[str, Field(min_length=1, max_length=500)]
"""A regular expression of Python's `re`."""
HostName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:-]+$", max_length=253), AfterValidator(check_host)]


class CustomRecoverySettings(Section):
    """What PHM may do while the check fails, with the same limits as any other action."""

    container: Name
    """Key of the container to act on; it needs `recover: true`."""
    action: Literal["restart"] = "restart"
    """The action."""


class CustomBase(Section):
    """Keys that each entry of `custom` has."""

    name: Name
    """Name of the check; its unit is `custom/NAME`."""
    period: Annotated[Seconds, Field(ge=0.5, le=3600)] = 10.0
    """Seconds between two runs."""
    timeout: Annotated[Seconds, Field(gt=0, le=60)] = 5.0
    """Longest time that one run may take."""
    needs: Annotated[list[str], Field(max_length=32)] = Field(default_factory=list)
    """Ids of units that it depends on, e.g. `container/ros_app`. While one of them has failed, this check is STALE."""
    slot: Annotated[int, Field(ge=1, le=15)] = 13
    """Slot of the status array; 13 to 15 are for own checks."""
    level: Literal["warn", "error"] = "error"
    """Level of a failure. `warn` opens no fault."""
    failures: Annotated[int, Field(ge=1, le=100)] = 2
    """How many runs in a row must fail before it is reported; for `log` the default is 1."""
    grace: Annotated[Seconds, Field(ge=0, le=600)] = 8.0
    """Seconds after a start of PHM, or of the container that it concerns, in which a failure does not count."""
    brief: Annotated[str, Field(pattern=r"^[ -~]+$", max_length=38)] | None = None
    """Text for the operator while it fails, at most 38 ASCII characters; default: the name and what was found."""
    advice: Annotated[str, Field(max_length=200)] = ""
    """What to do about a failure; added to the text in the log."""
    recovery: CustomRecoverySettings | None = None
    """Opt-in: what PHM may do about a failure; default: it is only reported."""
