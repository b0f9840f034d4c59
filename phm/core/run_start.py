"""Since when the results of the current run of a check count. Known in the thread of the run.

Checks that run one after the other count from the same moment. So a probe can answer them from one reading: none of their data is
older than that.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable, Iterator
from contextlib import contextmanager


class _Run(threading.local):
    since: float | None = None
    asked: frozenset[Hashable] = frozenset()


_run = _Run()


@contextmanager
def counting_from(since: float) -> Iterator[None]:
    """Results of this thread count from `since` (monotonic seconds)."""
    _run.since, _run.asked = since, frozenset()
    try:
        yield
    finally:
        _run.since = None


def oldest(subject: Hashable, now: float) -> float:
    """The moment (monotonic seconds) from which on a reading of `subject` is new enough. Only the first time in a run it is before
    `now`: a check that asks again wants to know what has changed."""
    if _run.since is None or subject in _run.asked:
        return now
    _run.asked |= {subject}
    return _run.since
