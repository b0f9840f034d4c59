"""`phm validate`: what it prints besides the problems of a file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group

CONFIG = Path(__file__).resolve().parents[2] / "config"


def test_schema_and_examples_are_printed() -> None:
    """In the repository they are those of config/."""
    schema = (CONFIG / "phm.schema.json").read_text("utf-8")
    assert CliRunner().invoke(group, ["validate", "--schema"]).stdout == schema
    assert CliRunner().invoke(group, ["validate", "--examples"]).stdout == f"{CONFIG}\n"


def test_without_examples_it_says_where_they_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Exit code 1."""
    monkeypatch.setattr("phm.config.shipped._PACKAGE", tmp_path / "phm")
    done = CliRunner().invoke(group, ["validate", "--examples"])
    assert done.exit_code == 1 and "part of the wheel and of the repository" in done.stderr


def test_one_of_a_kind_is_named_in_the_singular(tmp_path: Path) -> None:
    """None and several are not."""
    file = tmp_path / "phm.yaml"
    nodes = [{"name": "/agent_1/a"}, {"name": "/agent_1/b"}]
    file.write_text(json.dumps({"agent": {"id": 1}, "containers": [{"name": "app"}], "ros": {"nodes": nodes}}))
    done = CliRunner().invoke(group, ["validate", str(file)])
    assert done.exit_code == 0 and ", 1 container, 2 nodes, 0 topics, " in done.stdout


@pytest.mark.parametrize(("private", "count"), [(True, 1), (False, 0)])
def test_an_endpoint_that_does_not_leave_the_container_is_a_warning(
    private: bool, count: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The file is valid. One that does leave it, and a process with the host's network, have no warning."""
    monkeypatch.setattr("phm.transport.own_network.is_private", lambda: private)
    urls = ["udpout:127.0.0.1:14550", "udpout:host.docker.internal:14550"]
    endpoints = [{"name": f"link_{number}", "url": url} for number, url in enumerate(urls)]
    file = tmp_path / "phm.yaml"
    file.write_text(json.dumps({"agent": {"id": 1}, "mavlink": {"endpoints": endpoints}}))
    done = CliRunner().invoke(group, ["validate", str(file), "--json"])
    warnings = json.loads(done.stdout)["warnings"]
    assert done.exit_code == 0 and len(warnings) == count
    for text in warnings:
        assert "mavlink.endpoints: udpout:127.0.0.1:14550 does not leave PHM's container" in text
        assert "use udpout:host.docker.internal:14550 with `extra_hosts" in text
    shown = CliRunner().invoke(group, ["validate", str(file)])
    assert shown.exit_code == 0 and shown.stderr.count("warning: ") == count


@pytest.mark.parametrize("private", [True, False])
@pytest.mark.parametrize(
    ("url", "reach"),
    [
        (
            "udpin:0.0.0.0:14551",
            "can be reached only by containers on PHM's networks, unless `ports:` of its Compose file publishes it",
        ),
        ("udpin:127.0.0.1:14551", "listens only inside PHM's container: write 0.0.0.0 in place of the address"),
    ],
)
def test_an_endpoint_that_waits_for_peers_in_a_container_is_a_warning(
    url: str, reach: str, *, private: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """PHM sends nothing there before a peer has reached it. No error: a router may be in a container beside it."""
    monkeypatch.setattr("phm.transport.own_network.is_private", lambda: private)
    file = tmp_path / "phm.yaml"
    file.write_text(json.dumps({"agent": {"id": 1}, "mavlink": {"endpoints": [{"url": url}]}}))
    done = CliRunner().invoke(group, ["validate", str(file), "--json"])
    expected = [f"{file}: mavlink.endpoints: {url} {reach}"] if private else []
    assert (done.exit_code, json.loads(done.stdout)["warnings"]) == (0, expected)


@pytest.mark.parametrize(
    ("private", "listen", "count"),
    [(True, "127.0.0.1:9470", 1), (True, "localhost:9470", 1), (True, "0.0.0.0:9470", 0), (False, "127.0.0.1:9470", 0)],
)
def test_metrics_that_stay_in_the_container_are_a_warning(
    private: bool, listen: str, count: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With the port of the file in both lines to write."""
    monkeypatch.setattr("phm.transport.own_network.is_private", lambda: private)
    file = tmp_path / "phm.yaml"
    file.write_text(json.dumps({"agent": {"id": 1}, "metrics": {"listen": listen}}))
    done = CliRunner().invoke(group, ["validate", str(file), "--json"])
    warnings = json.loads(done.stdout)["warnings"]
    assert done.exit_code == 0 and len(warnings) == count
    for text in warnings:
        assert f"metrics.listen: {listen} cannot be reached" in text
        assert 'Use 0.0.0.0:9470, and `ports: ["127.0.0.1:9470:9470"]`' in text


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        ("unhealthy", ""),
        ("unhealty", "unknown condition 'unhealty', did you mean 'unhealthy'? No installed check reports it"),
        ("queue_overrun", "unknown condition 'queue_overrun'. No installed check reports it"),
    ],
)
def test_a_ladder_of_an_unknown_condition_is_a_warning(condition: str, words: str, tmp_path: Path) -> None:
    """A plug-in that is installed only on the agent may report it, so the file is valid."""
    file = tmp_path / "phm.yaml"
    file.write_text(json.dumps({"agent": {"id": 1}, "recovery": {"ladders": {condition: []}}}))
    done = CliRunner().invoke(group, ["validate", str(file), "--json"])
    warnings = json.loads(done.stdout)["warnings"]
    assert done.exit_code == 0 and len(warnings) == bool(words)
    assert all(f"recovery.ladders: {words}" in text for text in warnings)


def test_a_share_as_a_fraction_is_a_warning(tmp_path: Path) -> None:
    """A bare number is percent. With a unit it is meant, and other numbers below 1 are not shares."""
    file = tmp_path / "phm.yaml"
    file.write_text(
        "host:\n  cpu: {warn: 0.9, error: 0.98}\n  memory: {warn: 0.5%, error: 90}\n"
        "pressure:\n  memory_faults: {warn: 0.5, error: 0.7}\n"
        "ros:\n  topics:\n    - name: /a\n      rate: 0.5\n      tolerance: ${SHARE:-0.07}\n"
    )
    done = CliRunner().invoke(group, ["validate", str(file), "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["warnings"] == [
        f"{file}:2: host.cpu.warn: 0.9 is 0.9 %: write 90%, or 0.9% if that is meant",
        f"{file}:2: host.cpu.error: 0.98 is 0.98 %: write 98%, or 0.98% if that is meant",
        f"{file}:10: ros.topics[0].tolerance: 0.07 is 0.07 %: write 7%, or 0.07% if that is meant",
    ]
