"""Work that blocks, beside an event loop: its result arrives, and nothing waits for it that should not."""

from __future__ import annotations

import asyncio
import threading

import pytest

from phm.core import threads
from phm.core.own_thread import NoThread, in_own_thread
from tests.fakes.until import until


def test_the_result_or_the_error_arrives() -> None:
    """While the loop goes on with other tasks; the thread has its name and does not keep the process."""

    async def both() -> tuple[tuple[str, bool], bool]:
        go, ticked = threading.Event(), False

        def work() -> tuple[str, bool]:
            assert go.wait(60)
            return threading.current_thread().name, threading.current_thread().daemon

        async def tick() -> None:
            nonlocal ticked
            ticked = True
            go.set()

        found, _ = await asyncio.gather(in_own_thread("phm-test", work), tick())
        return found, ticked

    assert asyncio.run(both()) == (("phm-test", True), True)
    with pytest.raises(ZeroDivisionError):
        asyncio.run(in_own_thread("phm-test", lambda: 1 // 0))


def test_work_whose_caller_left_is_finished() -> None:
    """Without an error, also when the loop has ended meanwhile."""
    go, done = threading.Event(), threading.Event()

    def work() -> None:
        assert go.wait(60)
        done.set()

    async def leave() -> None:
        await asyncio.wait_for(in_own_thread("phm-test-left", work), 0.05)

    with pytest.raises(asyncio.TimeoutError):
        asyncio.run(leave())
    go.set()
    assert done.wait(60)
    until(lambda: "phm-test-left" not in {each.name for each in threading.enumerate()}, "the end of the thread")


def test_without_a_thread_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a limit of processes the caller says so."""
    monkeypatch.setattr(threads, "start_now", lambda thread: False)
    with pytest.raises(NoThread):
        asyncio.run(in_own_thread("phm-test", int))
