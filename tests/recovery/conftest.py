"""The fake engine, and the fixtures of the real one, which the tests of the Docker client share. Requests have long limits: the
machine may be busy."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.transport.docker import DockerEngine
from phm.wire import status_file
from tests.commands.long_limits import lengthen_limits
from tests.fakes.engine import FakeEngine
from tests.probes.docker.conftest import LONG_S, SOCKET, fake, real
from tests.proxy.conftest import proxies
from tests.proxy.haproxy import BehindProxy, EngineAccess

__all__ = ["ask", "engine", "engine_access", "fake", "proxies", "real"]


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for a status, which is valid for 5 s usually, and for an action that is asked what else may have helped."""
    lengthen_limits(monkeypatch)
    monkeypatch.setattr(status_file, "MAX_AGE_S", 600.0)
    monkeypatch.setattr("phm.recovery.verification.OTHER_CAUSE_S", LONG_S)


@pytest.fixture(params=["engine", "proxy"])
def engine(request: pytest.FixtureRequest) -> Iterator[DockerEngine]:
    """PHM's own client of the real engine: direct, and behind a proxy with the rules of the test's settings."""
    behind = request.param == "proxy"
    made = BehindProxy(request.getfixturevalue("proxies")) if behind else DockerEngine(SOCKET, timeout_s=LONG_S)
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
    """A client on the fake engine with a timeout that a busy machine does not reach."""
    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    yield engine
    engine.close()
