"""The fake engine, and the fixtures of the real one, which the tests of the Docker client share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.transport.docker import Engine
from tests.docker.conftest import engine, fake, real, until
from tests.fakes.engine import FakeEngine

__all__ = ["ask", "engine", "fake", "real", "until"]


@pytest.fixture
def ask(fake: FakeEngine) -> Iterator[Engine]:
    """An engine client on the fake, with the time-out that PHM has by default: a busy machine does not reach it."""
    engine = Engine(fake.url)
    yield engine
    engine.close()
