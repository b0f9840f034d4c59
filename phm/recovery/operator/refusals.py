"""Why a request of an operator is not carried out; each message says the reason."""

from __future__ import annotations


class NotApprovable(Exception):
    """There is nothing to approve about this fault."""


class NotAllowed(Exception):
    """It is not done, whenever it is requested."""


class NotNow(Exception):
    """It is not done now and may be later."""
