"""Limits that a busy machine exceeds are longer here: that a status is valid for 5 s is tested in tests/reporters/test_status.py."""

from __future__ import annotations

import pytest

from phm.wire import status_file
from tests.commands.long_limits import lengthen_limits


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)
    monkeypatch.setattr(status_file, "MAX_AGE_S", 600.0)
