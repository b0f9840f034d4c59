"""Waits in an event loop for work that blocks, without the loop's own threads: a process waits for those at its end."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

from phm.core import threads

T = TypeVar("T")


class NoThread(Exception):
    """The system allows no further thread now."""


async def in_own_thread(name: str, work: Callable[[], T]) -> T:
    """What `work` returns or raises. If the caller is cancelled, the work goes on. name: of the thread. Raises NoThread."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def finish(result: T | None, error: Exception | None) -> None:
        if done.cancelled():
            return
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(result)  # type: ignore[arg-type]  # it is T then

    def run() -> None:
        result, error = None, None
        try:
            result = work()
        except Exception as raised:
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(finish, result, error)

    if not threads.start_now(threading.Thread(target=run, name=name, daemon=True)):
        raise NoThread
    return await done
