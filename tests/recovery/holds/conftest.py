"""Fixtures for tests of holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.recovery.holds.scene import Scene


@pytest.fixture
def scenes() -> Iterator[Any]:
    made: list[Scene] = []

    def make(*words: Any, **more: Any) -> Scene:
        made.append(Scene(*words, **more))
        return made[-1]

    yield make
    for scene in made:
        scene.stop()


@pytest.fixture
def scene(scenes: Any) -> Scene:
    made: Scene = scenes()
    return made
