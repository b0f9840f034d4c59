"""A real HAProxy with the rules of checks without code: what they need passes, and no more."""

from __future__ import annotations

from typing import Any

import pytest

from phm.probes.logs import TAIL
from phm.testing import settings
from phm.transport import docker_bodies
from phm.transport.docker import DockerEngine, EngineRefused
from tests.fakes.until import until
from tests.proxy.haproxy import LIMIT_S, Proxies

# The engine may lose the output of a program that ends immediately.
FUEL, WAIT = ["sh", "-c", "echo FUEL low; sleep 0.5; exit 1"], "echo started; exec sleep 600"
API = "/v1.41"


def test_a_proxy_allows_the_configured_program_the_log_and_the_process_list_alone(real: Any, proxies: Proxies) -> None:
    """The program ends with its exit code through the proxy; another program, log or query, and a stream, get 403."""
    app, other = real.container(WAIT), real.container(WAIT)
    docker = proxies.docker()
    custom = [
        {"name": "fuel", "type": "command", "command": FUEL, "container": "app"},
        {"name": "log", "type": "log", "container": "app", "patterns": [{"pattern": "x"}]},
        {"name": "one", "type": "process", "process": ["x"], "container": "app"},
    ]
    containers = [{"name": app.name, "alias": "app"}, {"name": other.name, "alias": "other"}]
    proxy = proxies.before(settings(docker=docker, containers=containers, custom=custom))
    client = DockerEngine(docker["socket"], timeout_s=LIMIT_S)
    client.inspect(app.name)
    client.inspect(other.name)
    for _ in range(2):
        made = client.exec_create(app.id, FUEL)
        assert client.exec_read(made, 1000, deadline_s=LIMIT_S) == (b"FUEL low\n", b"")
        assert until(lambda: client.exec_exit_code(made), "its end") == 1  # noqa: B023 - called immediately
    until(lambda: b"started" in client.logs(app.id, "0.0", tail=TAIL, limit=1000), "the line in the log")
    assert client.top(app.id)["Processes"]
    for refused in (
        lambda: client.exec_create(app.id, ["sh"]),
        lambda: client.exec_create(other.id, FUEL),
        lambda: client.exec_exit_code("0123456789abcdef" * 4),
        lambda: client.exec_detached(app.id, FUEL),
        lambda: client.logs(other.id, "0.0", tail=TAIL, limit=1000),
        lambda: client.logs(app.id, "0.0&follow=1", tail=TAIL, limit=1000),
        lambda: client.top(other.id),
    ):
        with pytest.raises(EngineRefused):
            refused()
    start = f"{API}/exec/{client.exec_create(app.id, FUEL)}/start"
    stream = {"Connection": "Upgrade", "Upgrade": "tcp"}
    assert proxy.ask("POST", start, docker_bodies.START_ATTACHED.encode(), more=stream)[0] == 403
    body = docker_bodies.exec_attached(FUEL).encode()[:-1] + b', "Privileged": true}'
    assert proxy.ask("POST", f"{API}/containers/{app.name}/exec", body)[0] == 403
