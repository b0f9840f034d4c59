"""Processes of `phm run`. Requests to a daemon have long limits here, because the machine may be busy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.commands.long_limits import lengthen_limits
from tests.runtime.running import Running


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lengthen_limits(monkeypatch)


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
