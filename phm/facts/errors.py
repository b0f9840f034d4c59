"""Why a probe cannot answer."""

from __future__ import annotations


class CannotTell(Exception):
    """The probe could not find out; the message says why and what to do."""


class NoResponse(CannotTell):
    """The other side did not answer in time, or could not be reached."""


class NoAccess(NoResponse):
    """PHM lacks the permission to reach the other side, which may be well (EACCES of a socket)."""


class NotPermitted(CannotTell):
    """The other side refused the request for lack of permission (HTTP 403)."""
