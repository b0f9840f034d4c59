"""Calls of the engine have a long deadline here, because the machine may be busy; a test of a short one sets it."""

from __future__ import annotations

import pytest

from phm.logs import log_sources

ANSWER_S = 60.0


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_sources, "ANSWER_S", ANSWER_S)
