"""`phm.core.duplicate_filter`: keys are remembered for a time, within a limit."""

from __future__ import annotations

from phm.core.duplicate_filter import DuplicateFilter


def test_a_key_is_remembered_with_its_value_for_its_time() -> None:
    """Not longer than `keep_s`."""
    seen: DuplicateFilter[str, int] = DuplicateFilter(10, keep_s=5.0)
    assert seen.get("a", 0.0) is None
    seen.add("a", 1, 0.0)
    assert seen.get("a", 5.0) == 1
    assert seen.get("a", 5.1) is None


def test_adding_a_key_again_restarts_its_time() -> None:
    """Its value is the new one."""
    seen: DuplicateFilter[str, int] = DuplicateFilter(10, keep_s=5.0)
    seen.add("a", 1, 0.0)
    seen.add("a", 2, 4.0)
    assert seen.get("a", 8.0) == 2


def test_the_key_added_first_is_forgotten_first() -> None:
    """When there are more than `size`; adding a key again makes it the newest."""
    seen: DuplicateFilter[str, int] = DuplicateFilter(2)
    for number, key in enumerate(("a", "b", "a", "c")):
        seen.add(key, number)
    assert (seen.get("a"), seen.get("b"), seen.get("c"), len(seen)) == (2, None, 3, 2)
