"""Finding plug-ins: an unusable one is reported with its cause."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from phm.api import Check
from phm.checking import registry


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("no_such_module_anywhere:X", "cannot be imported"),
        ("phm.core.model:NoSuchName", "has no 'NoSuchName'"),
        ("phm.core.model:Level", "is not a subclass of phm.api.Check"),
        ("phm.api:Check", "has the name None"),
    ],
)
def test_each_load_error_has_its_own_text(value: str, words: str) -> None:
    """It keeps its cause, and the other checks still run."""
    found = registry._load(EntryPoint("mine", value, registry.CHECKS), Check)
    assert found.loaded is None
    assert words in found.problem


def test_two_packages_with_one_name_are_both_rejected() -> None:
    """It is unknown which one is meant."""
    twins = [registry.Plugin("x", "one 1.0", Check), registry.Plugin("x", "two 1.0", Check)]
    (merged,) = registry._without_duplicates(twins)
    assert merged.loaded is None
    assert "one 1.0, two 1.0" in merged.source
