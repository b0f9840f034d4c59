"""Calls to the Docker Engine through docker-py: a client for each thread, the API's version, deadlines and errors.

Calls run in the calling thread. An overdue call is interrupted (`phm.transport.call_deadlines`), even if the engine
sends a byte from time to time, which docker-py's own timeout does not detect.
"""

from __future__ import annotations

import contextlib
import tarfile
import threading
from collections.abc import Callable, Iterator
from http.client import HTTPException
from typing import Any, TypeVar

import requests
from docker import APIClient
from docker.errors import DockerException, create_api_error_from_http_exception
from requests.models import Response
from urllib3.exceptions import HTTPError

from phm.core.clock import Clock, SystemClock
from phm.facts import CannotTell
from phm.transport.call_deadlines import CallDeadlines, PendingCall
from phm.transport.docker_errors import EngineNotConnected, EngineUnreachable, translate
from phm.transport.docker_http import client_for, resolver_for, using

T = TypeVar("T")
Answer = dict[str, Any]

API_WANTED = (1, 44)
"""The newest API version that this module uses; an older engine is called with its own."""
API_FALLBACK = "1.41"
"""Used if a socket proxy hides /version: Docker 20.10 and later support it."""
ACT_MARGIN_S = 10.0
"""Additional seconds for changing calls: the engine waits this long for a kill to take effect."""
FAILURES = (
    requests.RequestException,
    HTTPError,
    DockerException,
    HTTPException,
    OSError,
    tarfile.TarError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    RecursionError,
)


class DockerSession:
    """The connection to one engine; `phm.transport.docker.DockerEngine` has the calls. Thread-safe; opens nothing.

    url: ``unix:///path``, ``tcp://host:port`` or ``ssh://[user@]host[:port]``. timeout_s: the default deadline of a call.
    """

    def __init__(self, url: str, timeout_s: float = 5.0, clock: Clock | None = None) -> None:
        self.url, self.timeout_s = url, timeout_s
        self._clock = clock or SystemClock()
        self._deadlines = CallDeadlines(self._clock, "phm-docker-deadlines")
        self._local = threading.local()  # docker-py's client is not thread-safe
        self._resolver = resolver_for(url)
        self._api = ""
        self.on_change: Callable[[], None] = lambda: None
        """Called after each call that may have changed something, also after a failed one: earlier readings are
        outdated."""

    @property
    def act_limit_s(self) -> float:
        """The deadline of a call that changes something, in seconds."""
        return self.timeout_s + ACT_MARGIN_S

    def call(self, fn: Callable[[APIClient], T], *, deadline_s: float | None = None, what: str = "answer") -> T:
        """Run `fn` on this thread's docker-py client with a deadline of `deadline_s` (default: the timeout)."""
        with self.calling(what, deadline_s) as (client, _):
            return fn(client)

    def _act(self, fn: Callable[[APIClient], T], what: str, grace_s: float = 0.0) -> T:
        """The same for a call that changes something. grace_s: how long the engine waits for a process to end."""
        try:
            return self.call(fn, deadline_s=self.act_limit_s + grace_s, what=what)
        finally:
            self.on_change()

    def close(self) -> None:
        """Interrupt running calls; every later call fails immediately."""
        self._deadlines.close()

    @contextlib.contextmanager
    def calling(self, what: str, deadline_s: float | None) -> Iterator[tuple[APIClient, PendingCall]]:
        """This thread's client for one call, with a deadline in seconds. Any failure inside is raised as EngineError."""
        limit_s = self.timeout_s if deadline_s is None else deadline_s
        with self._deadlines.watch(limit_s) as call, using(call):
            try:
                if call.expired:
                    raise EngineNotConnected("PHM is closing its connection to the Docker Engine")
                yield self._client(limit_s), call
            except CannotTell as error:
                # Reading may fail at the end of file that the deadline caused.
                raise translate(error, call, self.url, limit_s, what) if call.expired else error from error.__cause__
            except FAILURES as error:
                translated = translate(error, call, self.url, limit_s, what)
                if isinstance(translated, EngineUnreachable):
                    self._api = ""  # after a reconnect the engine may have another version
                raise translated from error
            # An interrupted response without a length looks complete.
            if call.expired:
                raise translate(TimeoutError(), call, self.url, limit_s, what)

    def _client(self, limit_s: float) -> APIClient:
        api = self._api or self._negotiate(limit_s)
        client: APIClient | None = getattr(self._local, "client", None)
        if client is None or client.api_version != api:
            client = self._local.client = client_for(self.url, api, self._resolver)
        client.timeout = limit_s  # type: ignore[assignment]  # the stubs say int; requests takes any number
        return client

    def _negotiate(self, limit_s: float) -> str:
        client = client_for(self.url, API_FALLBACK, self._resolver)
        client.timeout = limit_s  # type: ignore[assignment]
        try:
            answer = mapping(client.version(api_version=False))
        except DockerException as error:
            if getattr(error, "status_code", None) not in (401, 403, 404):
                raise
            self._api = API_FALLBACK
        else:
            newest, oldest = _numbers(answer["ApiVersion"]), _numbers(answer.get("MinAPIVersion") or "1.24")
            self._api = "{}.{}".format(*max(min(newest, API_WANTED), oldest))
        return self._api


def raise_for_status(response: Response) -> None:
    """Raises docker-py's APIError, with the engine's message."""
    try:
        response.raise_for_status()
    except requests.HTTPError as error:
        create_api_error_from_http_exception(error)


def _numbers(version: str) -> tuple[int, int]:
    major, _, minor = version.partition(".")
    return int(major), int(minor)


def mapping(answer: Any) -> Answer:
    """The response, which must be a JSON object. Raises TypeError, one of FAILURES."""
    if not isinstance(answer, dict):
        raise TypeError(f"expected an object, got {str(answer)[:80]!r}")
    return answer
