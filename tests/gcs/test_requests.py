"""`phm gcs approve`, `restart` and `check` to a real agent on loopback."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator

import pytest
from click.testing import CliRunner, Result

from phm.cli import gcs_requests, group
from phm.gcs import operator
from tests.fakes.mavlink import free_port
from tests.gcs.test_daemon import agent

Ask = Callable[..., Result]


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine an answer takes a while."""
    for module, limit in ((gcs_requests, "FOUND_S"), (gcs_requests, "ADVICE_S"), (operator, "REPLY_S")):
        monkeypatch.setattr(module, limit, 60.0)
    monkeypatch.setattr(operator, "RESEND_S", 15.0)


@pytest.fixture(scope="module")
def ask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ask]:
    """Sends a request to agent 7, whose container cannot be reached and which permits checks and restarts."""
    port = free_port(socket.SOCK_DGRAM)
    daemon = agent(
        tmp_path_factory.mktemp("agent"),
        7,
        f"udpout:127.0.0.1:{port}",
        engine=True,
        commands=["status", "details", "check", "restart"],
    )
    daemon.start()

    def run(*arguments: str) -> Result:
        return CliRunner().invoke(group, ["gcs", *arguments, "--url", f"udpin:127.0.0.1:{port}", "--for", "0"])

    yield run
    daemon.stop()


def test_a_check_is_accepted(ask: Ask) -> None:
    """With the agent's own words. A line about its engine may follow."""
    result = ask("check", "A07")
    assert (result.exit_code, result.output.splitlines()[0]) == (0, "A07 run all checks: accepted: running all checks")


def test_a_request_without_permission_is_refused_with_the_reason(ask: Ask) -> None:
    """By the agent, in one sentence; --json for programs."""
    result = ask("approve", "7", "#17", "--json")
    assert result.exit_code == 1
    assert json.loads(result.output) == {
        "agent": 7,
        "request": "approve #17",
        "result": "DENIED",
        "text": "'approve' is not in mavlink.commands",
        "lines": [],
    }


def test_a_container_is_named_or_numbered(ask: Ask) -> None:
    """The agent lists its containers; one without `recover: true` is not restarted."""
    refused = ask("restart", "a07", "app")
    assert refused.exit_code == 1
    assert refused.output.startswith("A07 restart app: failed: ")
    assert "recover" in refused.output
    unknown = ask("restart", "A07", "other")
    assert (unknown.exit_code, "A07 has no container 'other': it has app" in unknown.output) == (1, True)
    beyond = ask("restart", "A07", "3")
    assert "failed: container 3 does not exist: 1 are configured" in beyond.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("approve", "B05"), "write its name in the table or its id"),
        (("approve", "A251"), "write its name in the table or its id"),
        (("check",), "Missing argument 'AGENT'"),
        (("check", "A07", "--url", "udp:1"), "is not a MAVLink endpoint"),
    ],
)
def test_a_mistake_is_an_error_of_usage(arguments: tuple[str, ...], words: str) -> None:
    """Before anything is opened."""
    result = CliRunner().invoke(group, ["gcs", *arguments])
    assert (result.exit_code, words in result.output) == (2, True), result.output


def test_the_help_lists_the_requests() -> None:
    """And each has its own."""
    assert "Approve the action that an agent advises" in CliRunner().invoke(group, ["gcs", "--help"]).output
    for request in ("approve", "restart", "check"):
        assert "--key" in CliRunner().invoke(group, ["gcs", request, "--help"]).output
