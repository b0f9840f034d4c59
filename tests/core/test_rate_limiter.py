"""`phm.core.rate_limiter`: a burst, then a rate, for each key."""

from __future__ import annotations

from hypothesis import given, strategies as st

from phm.core.rate_limiter import RateLimiter, TokenBucket


def test_a_key_has_a_burst_and_then_a_rate() -> None:
    """After a pause the burst is available again, and not more."""
    limiter = RateLimiter(2.0, 10.0)
    assert sum(limiter.allow(0.0) for _ in range(100)) == 10
    assert sum(limiter.allow(1.0) for _ in range(100)) == 2
    assert sum(limiter.allow(1000.0) for _ in range(100)) == 10


def test_keys_do_not_affect_each_other() -> None:
    """Each key has its own tokens."""
    limiter = RateLimiter(1.0, 1.0, 2)
    assert limiter.allow(0.0, "a") and not limiter.allow(0.0, "a")
    assert limiter.allow(0.0, "b")


def test_what_is_left_of_a_key_is_known_before_it_is_used() -> None:
    """To ask counts as no event."""
    limiter = RateLimiter(1.0, 5.0, 2)
    assert [limiter.left(0.0, "a") for _ in range(2)] == [5.0, 5.0]
    assert "a" not in limiter and limiter.allow(0.0, "a")
    assert (limiter.left(0.0, "a"), limiter.left(0.5, "a"), limiter.left(0.5, "b")) == (4.0, 4.5, 5.0)


def test_the_key_used_longest_ago_is_forgotten_first() -> None:
    """When there are more than `max_keys`."""
    limiter = RateLimiter(1.0, 5.0, 2)
    for key in ("a", "b", "a", "c"):
        limiter.allow(0.0, key)
    assert ("a" in limiter, "b" in limiter, "c" in limiter, len(limiter)) == (True, False, True, 2)


@given(st.lists(st.floats(0, 0.5), max_size=200))
def test_no_more_than_burst_plus_rate_times_time_is_allowed(pauses: list[float]) -> None:
    """Whatever the pauses between the events are."""
    limiter, now, allowed = RateLimiter(3.0, 7.0), 0.0, 0
    for pause in pauses:
        now += pause
        allowed += limiter.allow(now)
    assert allowed <= 7.0 + 3.0 * now + 1e-6


def test_a_clock_that_goes_back_adds_no_tokens() -> None:
    """And raises no error."""
    bucket = TokenBucket(0.0, 10.0)
    bucket.refill(5.0, 100.0, 100.0)
    assert not bucket.take()


def test_a_bucket_without_a_limit_is_never_empty() -> None:
    """Infinite rate and burst."""
    bucket = TokenBucket(float("inf"), 0.0)
    for now in (0.0, 0.0, 1.0):
        bucket.refill(now, float("inf"), float("inf"))
        assert bucket.take(1e9)
