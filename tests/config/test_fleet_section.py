"""The section `fleet`: what is refused, and what is said about it."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from phm.config import ConfigError, loads
from phm.config.rules import fleet
from phm.core.settings import Settings

ON = "fleet:\n  enabled: true\n"
ROUTER = "  connect: [tcp/router:7447]\n"


def refused(text: str) -> dict[str, tuple[int, str]]:
    """Line and sentence by key, of a text that must be refused."""
    with pytest.raises(ConfigError) as caught:
        loads(text, "phm.yaml", environ={})
    return {problem.key: (problem.line, problem.message) for problem in caught.value.problems}


@pytest.mark.parametrize(
    ("text", "line", "key", "words"),
    [
        (ON, 2, "fleet.enabled", "neither 'connect' nor 'listen'"),
        (ON + "  listen: [tcp/0.0.0.0:7447]\n", 3, "fleet.listen", "mode: peer"),
        (ON + ROUTER + "  tls: {ca: /ca.pem}\n", 4, "fleet.tls.ca", "no endpoint is encrypted"),
        (ON + "  connect: [tls/router:7447]\n  tls: {key: /key.pem}\n", 4, "fleet.tls.key", "'certificate'"),
        (ON + "  connect: [tls/router:7447]\n  tls: {certificate: /a.pem}\n", 4, "fleet.tls.certificate", "'key'"),
        (ON + "  connect: [tcp/router:77447]\n", 3, "fleet.connect[0]", "1 to 65535"),
        (ON + "  connect: [udp/router:7447]\n", 3, "fleet.connect[0]", "tls/HOST:PORT"),
        (ON + "  connect: ['tcp/router:7447#iface=eth0']\n", 3, "fleet.connect[0]", "tcp/HOST:PORT"),
        (ON + ROUTER + "  name: '**'\n", 4, "fleet.name", "letters, digits"),
        (ON + ROUTER + "  name: a/b\n", 4, "fleet.name", "letters, digits"),
        (ON + ROUTER + "  name: '@x'\n", 4, "fleet.name", "letters, digits"),
        (ON + ROUTER + "  lease: 0.1s\n", 4, "fleet.lease", "1"),
        ("agent: {name: 'a#?'}\n" + ON + ROUTER, 1, "agent.name", "letters, digits"),
        ("agent: {name: 'a$*'}\n" + ON + ROUTER, 1, "agent.name", "letters, digits"),
    ],
)
def test_a_fleet_that_cannot_work_is_refused(text: str, line: int, key: str, words: str) -> None:
    """With its line, its key, and what is allowed; names that are no part of a key expression among them."""
    problems = refused(text)
    assert problems[key][0] == line
    assert words in problems[key][1]


def test_a_missing_package_is_said_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra, a configuration that wants it names what to install."""
    real = importlib.util.find_spec

    def without(name: str, *rest: Any) -> Any:
        return None if name == "zenoh" else real(name, *rest)

    monkeypatch.setattr(fleet, "find_spec", without)
    line, message = refused(ON + ROUTER)["fleet.enabled"]
    assert line == 2
    assert "pip install 'phm-sidecar[fleet]'" in message
    assert loads("fleet: {enabled: false}\n", "phm.yaml", environ={}).fleet == Settings().fleet


def test_what_can_work_is_taken() -> None:
    """A client by TLS, and a peer that listens."""
    client = loads(
        ON + "  connect: ['tls/[::1]:7447']\n  tls: {ca: /ca.pem, certificate: /a.pem, key: /a.key}\n", "f", environ={}
    )
    assert client.fleet.connect == ["tls/[::1]:7447"]
    peer = loads(ON + "  mode: peer\n  listen: [tcp/0.0.0.0:7447]\n", "f", environ={})
    assert peer.fleet.listen == ["tcp/0.0.0.0:7447"]
