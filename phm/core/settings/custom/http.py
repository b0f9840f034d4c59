"""Type `http` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.custom.base import CustomBase, Pattern


class HttpCheckSettings(CustomBase):
    """A web server answers a GET request as expected."""

    type: Literal["http"]
    """`http`: a web server answers a GET request."""
    url: Annotated[str, Field(pattern=r"^https?://[^\s/@]+(/[!-~]*)?$", max_length=2000)]
    """Address, http:// or https://, as PHM's container reaches it."""
    status: Annotated[list[Annotated[int, Field(ge=100, le=599)]], Field(min_length=1, max_length=16)] = Field(
        default_factory=lambda: [200]
    )
    """Status codes that are right. Redirects are not followed."""
    body: Pattern | None = None
    """Regular expression that must occur in the first 64 KiB of the body; default: the body is not read."""
    json_field: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Field of a JSON body that must exist, e.g. `state` or `sensors.0.ok`; default: none."""
    equals: str | float | bool | None = None
    """Value that `json_field` must have; default: any but null and false."""
    verify_tls: bool = True
    """False: any certificate is accepted."""
