"""`phm.core.backoff`: pauses double up to the longest."""

from __future__ import annotations

from phm.core.backoff import Backoff, pause_s


def test_pauses_double_up_to_the_longest() -> None:
    """Each failure doubles the pause, up to the maximum."""
    backoff = Backoff(0.5, 3.0)
    assert [backoff.next_s() for _ in range(5)] == [0.5, 1.0, 2.0, 3.0, 3.0]


def test_a_success_starts_with_the_first_pause_again() -> None:
    """`reset` forgets all failures."""
    backoff = Backoff(0.5, 3.0)
    backoff.next_s()
    backoff.next_s()
    backoff.reset()
    assert (backoff.pause_s, backoff.next_s(), backoff.pause_s) == (0.5, 0.5, 1.0)


def test_many_failures_do_not_overflow() -> None:
    """The pause stays at its maximum after any number of failures."""
    backoff = Backoff(0.1, 5.0)
    for _ in range(5000):
        backoff.next_s()
    assert backoff.next_s() == pause_s(10**6, 0.1, 5.0) == 5.0


def test_a_first_pause_above_the_longest_is_cut() -> None:
    """No pause is longer than `longest_s`."""
    assert pause_s(1, 10.0, 5.0) == 5.0
