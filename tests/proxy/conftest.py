"""The real engine, and proxies in front of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from tests.probes.docker.conftest import engine, real
from tests.proxy.haproxy import Proxies, short_folder

__all__ = ["engine", "proxies", "real"]


@pytest.fixture
def proxies(real: Any) -> Iterator[Proxies]:
    """With a container that represents PHM's own."""
    folder = short_folder()
    made = Proxies(folder, real.container().name)
    yield made
    made.end()
    shutil.rmtree(folder)
