"""Type `command` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from phm.core.settings.base import Name
from phm.core.settings.custom.base import CustomBase, Word


def _no_shell_string(value: Any) -> Any:
    if isinstance(value, str):
        words = ", ".join(value.split()[:8])
        raise ValueError(
            f"is text {value[:60]!r}, expected a list of words, because no shell is used: write [{words[:80]}]"
        )
    return value


class CommandCheckSettings(CustomBase):
    """A program, such as a plug-in of Nagios, ends with exit code 0."""

    type: Literal["command"]
    """`command`: a program ends with exit code 0; 1 is WARN, 2 a failure, any other STALE, as for plug-ins of Nagios."""
    command: Annotated[list[Word], Field(min_length=1, max_length=64), BeforeValidator(_no_shell_string)]
    """Program and arguments, word by word. No shell is used."""
    container: Name | None = None
    """Key of the container in which it is started; default: PHM's own, or the computer if PHM runs on it directly."""
