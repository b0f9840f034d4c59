"""Serve the clients of a listening stream socket in an event loop, one task for each.

Not `asyncio.start_server`: when that ends, a client that it has just accepted stays connected (Python 3.10 to 3.13).
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

logger = logging.getLogger(__name__)

RETRY_S = 1.0
"""After a failure to accept, such as too many open files."""

Handle = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
"""Serves one client; the connection is closed when it returns or raises."""


def run(main: Coroutine[Any, Any, None]) -> None:
    """Run it in an event loop of this thread that can watch a listener: the default one of Windows cannot."""
    loop = asyncio.SelectorEventLoop()
    try:
        loop.run_until_complete(main)
    finally:
        loop.close()


@asynccontextmanager
async def serving(listener: socket.socket, handle: Handle, limit: int) -> AsyncIterator[None]:
    """Serve within this context; at its end the listener and all clients are closed. limit: bytes of a line that is read."""
    loop, tasks = asyncio.get_running_loop(), set[asyncio.Task[None]]()

    def accept() -> None:
        try:
            peer, _address = listener.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError as error:
            logger.warning("a client could not be accepted: %s", error)
            loop.remove_reader(listener)
            loop.call_later(RETRY_S, watch)
            return
        peer.setblocking(False)
        task = loop.create_task(_serve(peer, handle, limit))
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        task.add_done_callback(lambda _task: peer.close())  # also if it is cancelled before it runs

    def watch() -> None:
        if listener.fileno() >= 0:
            loop.add_reader(listener, accept)

    listener.setblocking(False)
    watch()
    try:
        yield
    finally:
        loop.remove_reader(listener)
        listener.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.sleep(0)  # transports close their sockets in the next turn of the loop


async def _serve(peer: socket.socket, handle: Handle, limit: int) -> None:
    try:
        reader, writer = await asyncio.open_connection(sock=peer, limit=limit)
        try:
            await handle(reader, writer)
        finally:
            writer.transport.abort()
    except OSError:
        pass  # the client is gone
    except Exception:  # whatever one client does, the others are served
        logger.exception("a client could not be served")
