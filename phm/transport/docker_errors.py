"""Errors of calls to the Docker Engine, each with a sentence for the operator."""

from __future__ import annotations

import errno
from http import HTTPStatus

import requests
from docker.errors import APIError
from urllib3.exceptions import ProtocolError

from phm.facts import CannotTell, NoAccess, NoResponse, NotPermitted
from phm.transport.call_deadlines import PendingCall

_MAX_TEXT = 300


_BROKE = (requests.ConnectionError, requests.exceptions.ChunkedEncodingError, ProtocolError, ConnectionError, EOFError)


class EngineError(CannotTell):
    """Base class: the engine gave no usable response."""


class EngineTimeout(EngineError, NoResponse):
    """No complete response within the deadline, or within that of a proxy (HTTP 504)."""


class EngineUnreachable(EngineError, NoResponse):
    """No connection: no socket, no permission, no listener, the connection was lost, or a proxy has none (HTTP 502)."""


class EngineNotConnected(EngineUnreachable):
    """The connection failed, or that of a proxy (HTTP 503): the engine has not received the request."""


class EngineNoAccess(EngineNotConnected, NoAccess):
    """PHM may not open the socket."""


class EngineRefused(EngineError, NotPermitted):
    """HTTP 403, the response of socket proxies."""


class EngineConflict(EngineError):
    """HTTP 409, and 403 of the engine itself: the container or network is not in a state that allows this."""


class EngineMissing(EngineError):
    """HTTP 404: no such container, network or path."""


class EngineBroken(EngineError):
    """Other HTTP errors, such as 500, or an invalid answer."""


_NOT_NOW = ("already exists in network", "address already in use")
"""What the engine itself answers with HTTP 403, after an unclean stop or while another container has the address: no lack of permission,
and over later."""
_BY_STATUS: dict[int, type[EngineError]] = {
    401: EngineRefused,
    403: EngineRefused,
    404: EngineMissing,
    409: EngineConflict,
    502: EngineUnreachable,
    503: EngineNotConnected,
    504: EngineTimeout,
}


def translate(error: BaseException, call: PendingCall, url: str, limit_s: float, what: str) -> EngineError:
    """`error`, raised by the call `what` to the engine at `url`, converted to one of these classes."""
    if isinstance(error, EngineError):
        return error
    if call.expired:
        return _late(url, limit_s, what)
    if call.failure is not None:
        return _no_connection(call.failure, url, limit_s, what)
    if isinstance(error, APIError):
        return _by_status(error, what)
    # A socket's own timeout can occur just before the watchdog's.
    if isinstance(error, (requests.Timeout, TimeoutError)) or "timed out" in str(error).lower():
        return _late(url, limit_s, what)
    if isinstance(error, _BROKE):
        if "BadStatusLine" in repr(error) or "LineTooLong" in repr(error):
            return EngineBroken(f"{url} does not answer like a Docker Engine ({what}): {_short(error)}")
        return EngineUnreachable(f"the connection to the Docker Engine at {url} was lost ({what}): {_short(error)}")
    return EngineBroken(f"the Docker Engine at {url} sent an invalid answer ({what}): {_short(error)}")


def _late(url: str, limit_s: float, what: str) -> EngineTimeout:
    return EngineTimeout(
        f"the Docker Engine at {url} did not answer within {limit_s:.1f} s ({what}): it is unresponsive or overloaded; "
        "see `journalctl -u docker`"
    )


def _by_status(error: APIError, what: str) -> EngineError:
    status = int(error.status_code or 0)
    said = " ".join(str(error.explanation or error).split())[:_MAX_TEXT]
    kind = _BY_STATUS.get(status, EngineBroken)
    if status == HTTPStatus.FORBIDDEN and any(words in said.lower() for words in _NOT_NOW):
        kind = EngineConflict
    if kind is EngineRefused:
        return kind(
            f"the Docker Engine does not permit PHM to {what} (HTTP {status}): {said}; allow it at the socket proxy"
        )
    if issubclass(kind, NoResponse):
        return kind(f"the proxy has no answer of the Docker Engine (HTTP {status}, {what}): {said}")
    return kind(f"the Docker Engine answered HTTP {status} ({what}): {said}")


def _no_connection(error: OSError, url: str, limit_s: float, what: str) -> EngineError:
    if isinstance(error, TimeoutError):
        return _late(url, limit_s, what)
    path = url.removeprefix("unix://")
    if error.errno in (errno.EACCES, errno.EPERM):
        return EngineNoAccess(
            f"PHM may not open {path} (permission denied): add the docker group with group_add in the compose file"
        )
    if error.errno == errno.ENOENT:
        return EngineNotConnected(
            f"there is no {path}: start the Docker Engine, or mount its socket into PHM's container"
        )
    if error.errno == errno.ECONNREFUSED:
        # A bind mount of the socket's file leads to the old one after the engine has created another.
        # No further colon: `phm doctor` takes what follows the last one for the remedy.
        stale = "; if it runs, its socket was created again, so restart PHM's container" if path != url else ""
        return EngineNotConnected(f"no Docker Engine listens at {url}: start it, e.g. `systemctl start docker`{stale}")
    return EngineNotConnected(f"no connection to the Docker Engine at {url}: {_short(error)}")


def _short(error: BaseException) -> str:
    return " ".join((str(error) or type(error).__name__).split())[:_MAX_TEXT]
