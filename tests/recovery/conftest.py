"""The fake engine, and the fixtures of the real one, which the tests of the Docker client share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine
from tests.probes.docker.conftest import SOCKET, fake, real
from tests.proxy.conftest import proxies
from tests.proxy.haproxy import BehindProxy, EngineAccess

__all__ = ["ask", "engine", "engine_access", "fake", "proxies", "real"]


@pytest.fixture(params=["engine", "proxy"])
def engine(request: pytest.FixtureRequest) -> Iterator[DockerEngine]:
    """PHM's own client of the real engine: direct, and behind a proxy with the rules of the test's settings."""
    behind = request.param == "proxy"
    made = BehindProxy(request.getfixturevalue("proxies")) if behind else DockerEngine(SOCKET, timeout_s=10)
    yield made
    made.close()


@pytest.fixture(params=["engine", "proxy"])
def engine_access(request: pytest.FixtureRequest) -> EngineAccess:
    """How a daemon connects to the real engine: directly, and through a proxy."""
    if request.param == "engine":
        return EngineAccess({"socket": SOCKET}, lambda made: None)
    proxies = request.getfixturevalue("proxies")
    return EngineAccess(proxies.docker(), proxies.before)


@pytest.fixture
def ask(fake: FakeEngine) -> Iterator[DockerEngine]:
    """A client on the fake engine with PHM's default timeout, which a busy machine does not reach."""
    engine = DockerEngine(fake.url)
    yield engine
    engine.close()
