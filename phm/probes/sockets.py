"""Connects to servers as a client: what they send first, and what they answer to a GET request."""

from __future__ import annotations

import dataclasses
import socket

from phm.core.clock import Clock
from phm.facts import ConnectionFact, HttpFact
from phm.probes.connector import Connector, NotConnected, TimedCall
from phm.probes.http_get import get
from phm.probes.pattern_matcher import PatternMatcher

BANNER_BYTES = 4096


class Sockets:
    """Implements `phm.facts.SocketProbe`. Thread-safe."""

    def __init__(self, clock: Clock, matcher: PatternMatcher) -> None:
        self._connector, self._matcher = Connector(clock), matcher

    def close(self) -> None:
        """End running calls; every later call fails immediately."""
        self._connector.close()

    def connect(self, host: str, port: int, *, timeout_s: float, expect: str = "") -> ConnectionFact:
        with self._connector.calling(timeout_s) as call:
            try:
                connection = self._connector.open(host, port, call)
            except NotConnected as error:
                return ConnectionFact(str(error), call.took_s)
            with connection:
                took_s = call.took_s
                received = _banner(connection, expect.encode(), call) if expect else b""
            return ConnectionFact("", took_s, received.decode("utf-8", "replace"))

    def get(self, url: str, *, timeout_s: float, pattern: str = "", verify_tls: bool = True) -> HttpFact:
        fact = get(self._connector, url, timeout_s=timeout_s, verify_tls=verify_tls)
        if fact.problem or not pattern:
            return fact
        ((count, _),) = self._matcher.search([pattern], [fact.body])
        return dataclasses.replace(fact, found=count > 0)


def _banner(connection: socket.socket, expect: bytes, call: TimedCall) -> bytes:
    """What the server sends, until `expect` is in it, the server ends, or the time is over."""
    received = b""
    while expect not in received and len(received) < BANNER_BYTES:
        connection.settimeout(call.left_s)
        try:
            more = connection.recv(1024)
        except OSError:
            break
        if not more:
            break
        received += more
    return received[:BANNER_BYTES]
