"""A fake engine for faults, and the real one with its own containers and networks."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from docker import DockerClient
from docker.errors import DockerException, NotFound

from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine
from tests.fakes.until import until

SOCKET = "unix:///var/run/docker.sock"
LABEL = "phm.test.docker"
LONG_S, HUNG_S = 60.0, 4.0
"""Deadlines of requests: where an answer is expected, however busy the machine is; and in a test of an engine that never answers."""


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeEngine]:
    with FakeEngine(tmp_path / "engine.sock") as engine:
        yield engine


@pytest.fixture
def ask(fake: FakeEngine) -> Iterator[DockerEngine]:
    """A client of the fake engine. A test of a hung engine sets its `timeout_s` to HUNG_S."""
    engine = DockerEngine(fake.url, timeout_s=LONG_S)
    yield engine
    engine.close()


class Real:
    """Containers and networks on the real engine, all removed at the end."""

    def __init__(self, client: DockerClient, image: str) -> None:
        self.client, self.image = client, image
        self._mark = uuid.uuid4().hex[:8]
        self._removals: list[Callable[[], Any]] = []
        self.made = 0

    def name(self) -> str:
        self.made += 1
        return f"phm-test-{self._mark}-{self.made}"

    def container(
        self, command: str = "exec sleep 600", *, name: str = "", start: bool = True, asks_s: int = 0, **more: Any
    ) -> Any:
        """A container of the test image that runs `command` in a shell; `more`: arguments of docker-py.

        asks_s: its stop timeout, which docker-py's high-level interface cannot set.
        """
        labels = {LABEL: self._mark, **more.pop("labels", {})}
        argv, name = ["sh", "-c", command], name or self.name()
        if asks_s:
            host = self.client.api.create_host_config(init=True)
            answer = self.client.api.create_container(
                self.image, argv, name=name, labels=labels, host_config=host, stop_timeout=asks_s, **more
            )
            made = self.client.containers.get(answer["Id"])
        else:
            made = self.client.containers.create(self.image, argv, name=name, labels=labels, **{"init": True, **more})
        self._removals.append(lambda: made.remove(force=True, v=True))
        if start:
            made.start()
        return made

    def network(self, name: str = "") -> Any:
        """A network that is removed after all containers, since a network in use cannot be removed."""
        made = self.client.networks.create(name or self.name(), labels={LABEL: self._mark})
        self._removals.insert(0, made.remove)
        return made

    def volume(self) -> Any:
        made = self.client.volumes.create(self.name(), labels={LABEL: self._mark})
        self._removals.append(made.remove)
        return made

    def clean(self) -> None:
        for remove in self._removals[::-1]:
            try:
                remove()
            except NotFound:
                continue


@pytest.fixture
def real() -> Iterator[Real]:
    image = os.environ.get("PHM_TEST_IMAGE", "phm-base:dev")
    try:
        client = DockerClient(base_url=SOCKET, version="1.41", timeout=60)
        client.ping()
    except DockerException as error:
        pytest.fail(f"no Docker Engine answers at {SOCKET}: start one, or run scripts/test, which does ({error})")
    try:
        client.images.get(image)
    except DockerException:
        client.close()
        pytest.fail(f"the engine has no image {image}: run scripts/test, which makes it, or set PHM_TEST_IMAGE")
    made = Real(client, image)
    yield made
    made.clean()
    client.close()


def printed(made: Any, *argv: str) -> str:
    """The output of a program in a container that prints something. A busy engine now and then loses it: then it runs again."""

    def run() -> str:
        code, output = made.exec_run(list(argv))
        assert code in (0, None), output
        return str(output.decode()).strip() if code == 0 else ""

    return str(until(run, f"the output of {argv[0]}"))


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Iterator[DockerEngine]:
    """PHM's own client of the real engine. Its deadlines, also that of lists of processes, are long: the machine may be busy."""
    monkeypatch.setattr("phm.probes.docker_processes.LIMIT_S", LONG_S)
    engine = DockerEngine(SOCKET, timeout_s=LONG_S)
    yield engine
    engine.close()
