"""Type `http` of the section `custom`."""

from __future__ import annotations

from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from phm.core.settings.custom.base import CustomBase, Pattern


def _with_valid_port(url: str) -> str:
    try:
        valid = bool(urlsplit(url).hostname) and urlsplit(url).port != 0
    except ValueError:
        valid = False
    if not valid:
        raise ValueError(f"{url[:60]!r} has no valid host and port: write http://HOST[:PORT]/PATH or https://...")
    return url


Url = Annotated[str, Field(pattern=r"^https?://[^\s/@]+(/[!-~]*)?$", max_length=2000), AfterValidator(_with_valid_port)]


class HttpCheckSettings(CustomBase):
    """A web server answers a GET request as expected."""

    type: Literal["http"]
    """`http`: a web server answers a GET request."""
    url: Url
    """Address, http:// or https://, as PHM's container reaches it."""
    status: Annotated[list[Annotated[int, Field(ge=100, le=599)]], Field(min_length=1, max_length=16)] = Field(
        default_factory=lambda: [200]
    )
    """Accepted HTTP status codes. Redirects are not followed."""
    body: Pattern | None = None
    """Regular expression that must occur in the first 64 KiB of the body; default: any body."""
    json_field: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Field of a JSON body that must exist, e.g. `state` or `sensors.0.ok`; default: none."""
    equals: str | float | bool | None = None
    """Value that `json_field` must have; default: any but null and false."""
    verify_tls: bool = True
    """False: any certificate is accepted."""
