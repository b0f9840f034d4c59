"""The section `fleet`: rejected values and their messages."""

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
    """Line and message by key, of a text that must be rejected."""
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
def test_an_impossible_fleet_is_rejected(text: str, line: int, key: str, words: str) -> None:
    """With its line, its key, and the allowed values; this includes names that a key expression cannot contain."""
    problems = refused(text)
    assert problems[key][0] == line
    assert words in problems[key][1]


def test_a_missing_package_is_reported_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra, a configuration that needs it names the package to install."""
    real = importlib.util.find_spec

    def without(name: str, *rest: Any) -> Any:
        return None if name == "zenoh" else real(name, *rest)

    monkeypatch.setattr(fleet, "find_spec", without)
    line, message = refused(ON + ROUTER)["fleet.enabled"]
    assert line == 2
    assert "install the extra 'fleet' (in a clone of PHM: pip install '.[fleet]')" in message
    assert loads("fleet: {enabled: false}\n", "phm.yaml", environ={}).fleet == Settings().fleet


def test_a_possible_fleet_is_accepted() -> None:
    """A TLS client, and a listening peer."""
    client = loads(
        ON + "  connect: ['tls/[::1]:7447']\n  tls: {ca: /ca.pem, certificate: /a.pem, key: /a.key}\n", "f", environ={}
    )
    assert client.fleet.connect == ["tls/[::1]:7447"]
    peer = loads(ON + "  mode: peer\n  listen: [tcp/0.0.0.0:7447]\n", "f", environ={})
    assert peer.fleet.listen == ["tcp/0.0.0.0:7447"]
