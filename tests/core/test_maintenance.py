"""Maintenance windows as text."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest

from phm.core.maintenance import parse


def utc(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=timezone.utc).timestamp()


# 2026-11-22 is a Sunday.
@pytest.mark.parametrize(
    ("window", "now", "left_s"),
    [
        ("02:00-04:00", "2026-11-22T02:00", 7200.0),
        ("02:00-04:00", "2026-11-22T03:59", 60.0),
        ("sun 02:00-04:00", "2026-11-22T03:00", 3600.0),
        ("Mon-Fri 12:00-12:30", "2026-11-20T12:15", 900.0),
        ("fri-mon 12:00-12:30", "2026-11-22T12:15", 900.0),
        ("sat,mon 22:00-01:00", "2026-11-22T00:30", 1800.0),
        ("2026-11-22  22:00-01:00", "2026-11-23T00:30", 1800.0),
    ],
)
def test_a_window_is_open_until_its_end(window: str, now: str, left_s: float) -> None:
    """Days are those of the start, so that a window may span midnight."""
    found = parse(window).open_at(utc(now))
    assert found is not None and found[1] == left_s


@pytest.mark.parametrize(
    ("window", "now"),
    [
        ("02:00-04:00", "2026-11-22T04:00"),
        ("02:00-04:00", "2026-11-22T01:59"),
        ("sun 02:00-04:00", "2026-11-23T03:00"),
        ("sat,mon 22:00-01:00", "2026-11-23T00:30"),
        ("2026-11-22 22:00-01:00", "2026-11-22T00:30"),
        ("02:00-04:00", "1970-01-01T03:00"),
    ],
)
def test_a_window_is_closed_otherwise(window: str, now: str) -> None:
    """Also with a clock that was never set."""
    assert parse(window).open_at(utc(now)) is None


def test_two_occurrences_have_different_names() -> None:
    """A released occurrence stays closed, the next one opens."""
    window = parse("02:00-04:00")
    first, same, second = (window.open_at(utc(f"2026-11-{day}")) for day in ("22T02:10", "22T03:50", "23T02:10"))
    assert first and same and second and first[0] == same[0] != second[0]


@pytest.mark.parametrize(
    ("window", "its_own"),
    [
        ("sat 22:00-01:00", True),
        ("2026-11-21 22:00-01:00", True),
        ("sat 22:00-02:00", False),
        ("sat 23:00-01:00", False),
        ("sun 22:00-01:00", False),
    ],
)
def test_an_occurrence_belongs_to_a_window_with_its_beginning_and_end(window: str, its_own: bool) -> None:
    """It is known again after a change of the configuration, also after it has ended."""
    found = parse("22:00-01:00").open_at(utc("2026-11-22T00:30"))
    assert found and parse(window).has(found[0]) is its_own
    assert not parse(window).has("2026-11-21T22:00Z") and not parse(window).has("")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2-4",
        "sun",
        "02:00-02:00",
        "25:00-26:00",
        "son 02:00-04:00",
        "02:00-04:00 x",
        "2026-13-01 02:00-03:00",
        "sun- 02:00-04:00",
    ],
)
def test_an_invalid_window_is_rejected(text: str) -> None:
    """The error says what is allowed."""
    with pytest.raises(ValueError, match="HH:MM-HH:MM"):
        parse(text)
