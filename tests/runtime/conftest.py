"""Processes of `phm run`. Requests to a daemon have long limits here, because the machine may be busy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.closing import ShutdownSequence
from tests.commands.long_limits import lengthen_limits
from tests.runtime.running import LIMIT_S, Running


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """On a busy machine a step that does not hang may take longer than its limit: only the named ones keep theirs."""
    step = ShutdownSequence.step

    def lengthen(*kept: str) -> None:
        def lengthened(closing: ShutdownSequence, name: str, call: Callable[[], object], limit_s: float) -> None:
            step(closing, name, call, limit_s if name in kept else LIMIT_S)

        monkeypatch.setattr(ShutdownSequence, "step", lengthened)
        monkeypatch.setattr("phm.runtime.daemon.STOP_S", 20 * LIMIT_S)

    return lengthen


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    made: list[Running] = []

    def begin(*before: str, **more: Any) -> Running:
        made.append(Running(tmp_path, *before, **more))
        return made[-1]

    yield begin
    for running in made:
        if running.process.poll() is None:
            running.process.kill()
        running.process.communicate()
