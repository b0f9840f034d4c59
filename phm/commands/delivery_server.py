"""The agent's end of `phm deliver`: a TCP port that takes a configuration from a sender that has the key (`phm.wire.delivery`).

A sender without the key makes it read at most one short line, and cannot hold a place: connections are limited in time, number
and rate. One delivery is executed at a time, in a separate thread, because it validates, writes and reloads.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import socket
import threading
from collections.abc import Callable

from phm.core import threads
from phm.core.clock import Clock
from phm.core.own_thread import NoThread, in_own_thread
from phm.core.rate_limiter import RateLimiter
from phm.core.stream_server import run, serving
from phm.wire import delivery as wire
from phm.wire.delivery import DeliveryAnswer, Hello, NotADelivery, Request

logger = logging.getLogger(__name__)

REQUEST_S, BODY_S, ANSWER_S = 5.0, 30.0, 5.0
"""Deadlines for the request, the configuration, and until the client has read its answer."""
MAX_CLIENTS, MAX_SAME = 16, 2
"""Connections together, and of one address."""
RATE, BURST, MAX_ADDRESSES = 1 / 6, 10.0, 1024
"""Connections of one address: per second, and in a burst."""
NOTE_RATE, NOTE_BURST = 1 / 60, 3.0
"""Lines in the log about refused senders."""
RETRY_S, CLOSING_S = 5.0, 1.0

Execute = Callable[[str, str, str], DeliveryAnswer]
"""Takes the text, the version that it replaces, and who sends it. Never raises."""


class DeliveryServer:
    """Serves from `start` until `close`. A port that cannot be opened is tried again, and is a problem meanwhile."""

    def __init__(
        self,
        where: tuple[str, int],
        key: bytes,
        agent: str,
        clock: Clock,
        execute: Execute,
        note: Callable[[str], None],
    ) -> None:
        """note: writes a line into the log."""
        self._where, self._key, self._agent, self._clock = where, key, agent, clock
        self._execute, self._note = execute, note
        self._problem = ""
        self._rate, self._notes = RateLimiter(RATE, BURST, MAX_ADDRESSES), RateLimiter(NOTE_RATE, NOTE_BURST)
        self._waiting: dict[asyncio.Task[None], str] = {}
        """The addresses of clients that have not shown that they have the key; oldest first."""
        self._under_way = False
        self.address: tuple[str, int] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end, self._closing = asyncio.Event(), threading.Event()
        self._thread = threading.Thread(target=lambda: run(self._serve()), name="phm-delivery", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def problem(self) -> str:
        """A sentence while it does not listen, else empty."""
        return self._problem

    def close(self) -> None:
        self._closing.set()
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self._end.set)
        threads.join(self._thread, CLOSING_S)

    # ------------------------------------------------------------ the thread

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        while (listener := self._listen()) is None and not self._closing.is_set():
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._end.wait(), RETRY_S)
        if listener is None:
            return
        async with serving(listener, self._client, wire.MAX_LINE):
            if not self._closing.is_set():  # `close` may have been called before there was a loop
                await self._end.wait()

    def _listen(self) -> socket.socket | None:
        host, port = self._where
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            listener = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        except OSError as error:
            why = (error.strerror or str(error)).partition(" (while ")[0]
            self._problem = f"delivery.listen {host}:{port}: {why}; `phm deliver` does not work"
            return None
        self._problem, self.address = "", listener.getsockname()[:2]
        return listener

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        who = str((writer.get_extra_info("peername") or ("an unknown address",))[0])
        task = asyncio.current_task()
        assert task is not None
        if list(self._waiting.values()).count(who) >= MAX_SAME or not self._rate.allow(self._clock.mono(), who):
            await _send(writer, wire.answer_line(DeliveryAnswer(False, "too many connections: wait a minute")))
            return
        while len(self._waiting) >= MAX_CLIENTS:
            oldest = next(iter(self._waiting))
            del self._waiting[oldest]
            oldest.cancel()
        self._waiting[task] = who
        try:
            found = await self._identify(reader, writer, who)
        finally:
            self._waiting.pop(task, None)
        if found is not None:
            answer = await self._deliver(reader, found, who)
            await _send(writer, wire.answer_line(answer, self._key, found))

    async def _identify(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, who: str) -> Request | None:
        """The request of a sender that has the key; others get an answer that says what is wrong."""
        said, line = wire.hello(self._agent)
        writer.write(line)
        try:
            request = await asyncio.wait_for(self._request(reader, said), REQUEST_S)
        except asyncio.TimeoutError:
            why = f"no request within {REQUEST_S:g} s"
        except NotADelivery as error:
            why = str(error)
        else:
            return request
        if self._notes.allow(self._clock.mono()):
            self._note(f"a configuration from {who} was refused: {why}")
        await _send(writer, wire.answer_line(DeliveryAnswer(False, why)))
        return None

    async def _request(self, reader: asyncio.StreamReader, said: Hello) -> Request:
        try:
            line = await reader.readuntil(b"\n")
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            raise NotADelivery("this is not a request of `phm deliver`") from None
        request = wire.read_request(line)
        if not wire.authentic(request, said, self._key):
            raise NotADelivery("the key is not this agent's, or the request was replayed: use this agent's key")
        return request

    async def _deliver(self, reader: asyncio.StreamReader, request: Request, who: str) -> DeliveryAnswer:
        if not 0 <= request.size <= wire.MAX_SIZE:
            return DeliveryAnswer(False, f"a configuration has at most {wire.MAX_SIZE} bytes, not {request.size}")
        if self._under_way:
            return DeliveryAnswer(False, "another configuration is being delivered: try again when that is done")
        self._under_way = True
        try:
            return await self._take(reader, request, who)
        finally:
            self._under_way = False

    async def _take(self, reader: asyncio.StreamReader, request: Request, who: str) -> DeliveryAnswer:
        try:
            body = await asyncio.wait_for(reader.readexactly(request.size), BODY_S)
        except asyncio.TimeoutError:
            return DeliveryAnswer(False, f"the configuration did not arrive within {BODY_S:g} s")
        except asyncio.IncompleteReadError:
            return DeliveryAnswer(False, "the configuration is incomplete")
        if hashlib.sha256(body).hexdigest() != request.version:
            return DeliveryAnswer(False, "the configuration was altered in transit")
        try:
            text = body.decode("utf-8")
        except UnicodeDecodeError:
            return DeliveryAnswer(False, "the configuration is not UTF-8: save it as UTF-8")
        try:
            return await in_own_thread("phm-delivery-apply", lambda: self._execute(text, request.base, who))
        except NoThread:
            return DeliveryAnswer(False, "PHM cannot start a thread: try again")
        except Exception:  # a defect; its text is not for the network
            logger.exception("a configuration could not be delivered")
            return DeliveryAnswer(False, "PHM failed: see its log")


async def _send(writer: asyncio.StreamWriter, line: bytes) -> None:
    """The last words: then the connection is closed."""
    writer.write(line)
    with contextlib.suppress(asyncio.TimeoutError, OSError):
        writer.write_eof()
        await asyncio.wait_for(writer.drain(), ANSWER_S)
        await asyncio.wait_for(_written(writer), ANSWER_S)


async def _written(writer: asyncio.StreamWriter) -> None:
    writer.close()
    await writer.wait_closed()
