"""Regular expressions are searched in a child process that can be killed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell
from phm.probes.pattern_matcher import PatternMatcher


@pytest.fixture
def matcher() -> Iterator[PatternMatcher]:
    made = PatternMatcher(SystemClock(), limit_s=60.0)
    yield made
    made.close()


def test_each_pattern_has_its_count_and_its_last_line(matcher: PatternMatcher) -> None:
    """Also with text that is not ASCII, and with no lines."""
    lines = ["ok", "ERROR grün \x00", "WARN", "ERROR 2"]
    assert matcher.search(["ERROR", "grün", "FATAL"], lines) == [(2, 3), (1, 1), (0, -1)]
    assert matcher.search(["ERROR"], []) == [(0, -1)]


def test_much_text_is_searched(matcher: PatternMatcher) -> None:
    """More than a pipe holds."""
    assert matcher.search(["z$"], ["x" * 2000 + "z"] * 500) == [(500, 499)]


def test_a_pattern_that_takes_exponential_time_is_given_up() -> None:
    """The child is killed, and the next search works."""
    matcher = PatternMatcher(SystemClock(), limit_s=2.0)
    try:
        with pytest.raises(CannotTell, match="took longer than 2 s"):
            matcher.search(["(a+)+$"], ["a" * 60 + "b"])
        matcher._limit_s = 60.0  # a busy machine may need seconds to start the next child
        assert matcher.search(["b"], ["b"]) == [(1, 0)]
    finally:
        matcher.close()


def test_after_the_end_nothing_is_searched(matcher: PatternMatcher) -> None:
    """PHM that stops starts no child."""
    matcher.close()
    with pytest.raises(CannotTell, match="stopping"):
        matcher.search(["b"], ["b"])
