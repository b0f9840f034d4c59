"""Requests to a daemon have long limits here, because the machine may be busy."""

from __future__ import annotations

import pytest

from tests.commands.long_limits import lengthen_limits


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)
