"""One agent's place in a fleet on Zenoh: a session that is opened and kept open, a status, a token of presence.

One thread does all of it, so a Zenoh call that blocks delays nothing else. Zenoh reconnects to a lost router by itself
and repeats its declarations; this thread opens the session and publishes the status after each reconnect.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from phm.core import threads
from phm.core.backoff import Backoff
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.settings import FleetSettings
from phm.transport import zenoh_config

logger = logging.getLogger(__name__)

BACKOFF_S, BACKOFF_MAX_S = 0.5, 5.0
IDLE_S = 0.5
"""How soon a lost or new connection is detected."""
STUCK_S = 10.0
"""A turn of the thread that takes this much longer than the deadlines of all endpoints is reported: a Zenoh call hangs."""
MAX_QUERIES, MAX_NAMESAKES = 64, 16
FAREWELL_S = 2.0
FAREWELL_LEAD_S = 0.2
"""The last status is sent this long before the token is taken back: Zenoh gives declarations a higher priority than any
data, so a token that is taken back immediately overtakes the status (seen in about every second run on a busy machine)."""


@dataclass(frozen=True, slots=True)
class FleetKeys:
    """status: where the status goes. alive: the token of this PHM. namesakes: the tokens of all PHMs with this agent's name."""

    status: str
    alive: str
    namesakes: str


@dataclass(frozen=True, slots=True)
class FleetFact:
    """How the connection is. since_s: for how long it has been so. error: why it is not connected, in words.

    published, answered: messages since the start; bytes_out: of their payload. connects: how often it was connected.
    namesakes: tokens of other PHMs with the same name that do not go away.
    """

    connected: bool
    since_s: float
    error: str
    published: int
    answered: int
    bytes_out: int
    connects: int
    namesakes: tuple[str, ...]


class ZenohLink:
    """See the module. `start` opens the session. Every method but `close` returns immediately."""

    def __init__(self, settings: FleetSettings, keys: FleetKeys, clock: Clock) -> None:
        self._settings, self._keys, self._clock = settings, keys, clock
        self._bell, self._stopping = threading.Event(), threading.Event()
        self._newest = b""
        self._due = self._present = False
        self._queries: BoundedQueue[Any] = BoundedQueue(clock, MAX_QUERIES)
        self._links: set[str] = set()
        self._namesakes: dict[str, float] = {}
        self._connected, self._error = False, "not tried yet"
        self._since = self._turned = clock.mono()
        self._published = self._answered = self._bytes_out = self._connects = 0
        self._thread = threading.Thread(target=self._loop, name="phm-fleet", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def put(self, payload: bytes) -> None:
        """Publish this now or as soon as there is a connection. It replaces a payload that still waits."""
        self._newest, self._due = payload, True
        self._bell.set()

    def present(self, yes: bool) -> None:
        """Whether this PHM monitors its agent: only then does its token exist, and only then are queries answered."""
        if yes is not self._present:
            self._present = yes
            self._bell.set()

    def fact(self) -> FleetFact:
        now, error = self._clock.mono(), self._error
        stuck_s = now - self._turned
        if self._thread.ident is not None and not self._stopping.is_set():
            if not self._thread.is_alive():
                error = "the thread of the Zenoh session has ended"
            elif stuck_s > self._settings.deadline * max(1, len(self._settings.connect)) + STUCK_S:
                error = f"Zenoh has not responded for {stuck_s:.0f} s"
        # The token of an earlier PHM disappears within its lease.
        steady_s = 1.5 * self._settings.lease
        namesakes = tuple(name for name, since in list(self._namesakes.items()) if now - since > steady_s)
        return FleetFact(
            self._connected and not error,
            now - self._since,
            error,
            self._published,
            self._answered,
            self._bytes_out,
            self._connects,
            namesakes,
        )

    def close(self, last: bytes = b"") -> None:
        """Publish `last` if connected, withdraw the token, and close; waits at most FAREWELL_S."""
        if last:
            self.put(last)
        self._stopping.set()
        self._bell.set()
        threads.join(self._thread, FAREWELL_S)

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        backoff = Backoff(BACKOFF_S, BACKOFF_MAX_S)
        while not self._stopping.is_set():
            opened = False
            self._turned = self._clock.mono()
            try:
                session = self._open()
                opened = True
                self._serve(session)
            except BaseException as error:  # a panic in Zenoh is not an Exception; it must not end this thread either
                if opened:
                    logger.warning("fleet: the Zenoh session failed and is reopened", exc_info=True)
                self._set_state(connected=False, error=zenoh_config.error_text(error))
            if opened:
                backoff.reset()
            self._turned = self._clock.mono()
            self._clock.wait(self._stopping, backoff.next_s())

    def _open(self) -> Any:
        import zenoh

        zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call] # silent unless the environment has RUST_LOG
        return zenoh.open(zenoh_config.make_config(self._settings))

    def _serve(self, session: Any) -> None:
        try:
            declared = ZenohDeclarations(session, self._keys, self._asked, self._seen, self._has_readers)
            while not self._stopping.is_set() and not session.is_closed():
                self._turn(session, declared)
                self._clock.wait(self._bell, IDLE_S)
                self._bell.clear()
            self._say_farewell(session, declared)
        finally:
            self._set_state(connected=False, error="closed")
            self._namesakes.clear()
            self._links = set()
            session.close()

    def _say_farewell(self, session: Any, declared: ZenohDeclarations) -> None:
        last, self._due = self._newest if self._due else b"", False
        self._turn(session, declared)
        if last and self._connected:
            declared.publish_last(last)
            self._published += 1
            self._bytes_out += len(last)
            self._clock.wait(threading.Event(), FAREWELL_LEAD_S)
        declared.present(False)

    def _turn(self, session: Any, declared: ZenohDeclarations) -> None:
        self._turned = self._clock.mono()
        # Zenoh may lose a connection and have a new one between two looks: that one comes from another port.
        links = {f"{link.zid} {link.src} {link.dst}" for link in session.info.links()}
        connected = bool(links)
        if links - self._links:
            self._connects += 1
            self._due = bool(self._newest)  # subscribers behind the lost connection have missed updates
        self._links = links
        if connected != self._connected or not connected:
            self._set_state(connected=connected, error="" if connected else self._no_connection())
        declared.present(self._present)
        if self._due and connected and self._present:
            # Before the payload is read: one that is put meanwhile is due again.
            self._due = False
            payload = self._newest
            declared.publish(payload)
            self._published += 1
            self._bytes_out += len(payload)
        self._answer(declared)

    def _answer(self, declared: ZenohDeclarations) -> None:
        """At most MAX_QUERIES in one turn: a peer that asks all the time must not keep the status from being published."""
        for _ in range(min(len(self._queries), MAX_QUERIES)):
            declared.answer(self._queries.next(), self._newest if self._present else b"")
            self._answered += 1
        if self._queries:
            self._bell.set()

    def _no_connection(self) -> str:
        return (
            f"no connection to {', '.join(self._settings.connect)}"
            if self._settings.connect
            else "no peer has connected"
        )

    def _set_state(self, *, connected: bool, error: str) -> None:
        if connected != self._connected:
            self._since = self._clock.mono()
            logger.info("fleet: %s", "connected" if connected else error)
        self._connected, self._error = connected, error

    # ------------------------------------------------------------ from Zenoh's threads

    def _asked(self, query: Any) -> None:
        self._queries.put(query)
        self._bell.set()

    def _has_readers(self, yes: bool) -> None:
        """A status that is published before the router knows of any reader goes nowhere, also just after a reconnect."""
        if yes and self._present and self._newest:
            self._due = True
            self._bell.set()

    def _seen(self, token: str, there: bool) -> None:
        if token == self._keys.alive:
            return
        if not there:
            self._namesakes.pop(token, None)
        elif len(self._namesakes) < MAX_NAMESAKES:
            self._namesakes.setdefault(token, self._clock.mono())


class ZenohDeclarations:
    """What one session has declared; Zenoh declares it again by itself after each reconnect."""

    def __init__(
        self,
        session: Any,
        keys: FleetKeys,
        asked: Callable[[Any], None],
        seen: Callable[[str, bool], None],
        has_readers: Callable[[bool], None],
    ) -> None:
        import zenoh

        self._session, self._keys = session, keys
        self._token: Any = None
        # A router drops what a slow reader does not take instead of waiting for it: others are not held up, and what was
        # lost comes with the next refresh.
        self._publisher = session.declare_publisher(
            keys.status, encoding=zenoh.Encoding.APPLICATION_JSON, congestion_control=zenoh.CongestionControl.DROP
        )
        self._kept = (
            self._publisher.declare_matching_listener(lambda status: has_readers(bool(status.matching))),
            session.declare_queryable(keys.status, asked, complete=True),
            session.liveliness().declare_subscriber(
                keys.namesakes,
                lambda sample: seen(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT),
                history=True,
            ),
        )
        self._json = zenoh.Encoding.APPLICATION_JSON

    def present(self, yes: bool) -> None:
        if yes and self._token is None:
            self._token = self._session.liveliness().declare_token(self._keys.alive)
        elif not yes and self._token is not None:
            self._token.undeclare()
            self._token = None

    def publish(self, payload: bytes) -> None:
        self._publisher.put(payload)

    def publish_last(self, payload: bytes) -> None:
        """Publish ahead of everything else, and wait for room instead of dropping it: no refresh follows."""
        import zenoh

        self._session.put(
            self._keys.status,
            payload,
            encoding=self._json,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
        )

    def answer(self, query: Any, payload: bytes) -> None:
        """One reply, or none for an empty payload."""
        with query:
            if payload:
                query.reply(self._keys.status, payload, encoding=self._json)
