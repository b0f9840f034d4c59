"""Tests with a real container use the fixtures of tests/probes/docker; all have long limits for requests."""

from __future__ import annotations

import pytest

from tests.commands.long_limits import lengthen_limits
from tests.probes.docker.conftest import real

__all__ = ["real"]


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)
