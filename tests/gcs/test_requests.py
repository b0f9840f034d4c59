"""`phm gcs approve`, `restart` and `check` to a real agent on loopback."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import click
import pytest
from click.testing import CliRunner, Result

from phm.cli import gcs_requests, group
from phm.core.model import Level, Slot
from phm.gcs import operator
from phm.gcs.events import GcsEvent
from phm.gcs.subscriber_queue import QueuedEvent
from tests.fakes.mavlink import free_port
from tests.gcs.bench import Ground, phm_heartbeat, text_frame
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


# ---------------------------------------------------------------- the only advised action

FIRST, SECOND = "A05 ADVISE 2 restart ros_app #17 60s", "A05 ADVISE 6 relaunch node_1 #18 60s"
REFRESH = "A05 FAIL 10111011 2 ros_app exited 1 +1"


class SlowAgent:
    """A station and its queue in fake time: agent 5 sends a heartbeat at each look, and each line at its time (s)."""

    def __init__(self, lines: Mapping[float, str]) -> None:
        self._ground, self._lines = Ground(), sorted(lines.items())
        self._beat = phm_heartbeat(5, {Slot.CONTAINER: Level.ERROR, Slot.NODES: Level.ERROR})
        self._ground.receive(self._beat)
        self.client = gcs_requests._Client(cast(Any, self), cast(Any, self), self._ground.clock, 5)
        self._began = self._ground.clock.mono()

    @property
    def took_s(self) -> float:
        return self._ground.clock.mono() - self._began

    def take(self, timeout_s: float) -> list[QueuedEvent]:
        self._ground.clock.advance(timeout_s)
        found = self._ground.receive(self._beat)
        while self._lines and self._lines[0][0] <= self.took_s:
            found += self._ground.receive(text_frame(5, self._lines.pop(0)[1], 4))
        return [QueuedEvent(0, event, b"") for event in found]

    def snapshot(self) -> tuple[int, GcsEvent]:
        return 0, GcsEvent(self._ground.clock.stamp(), "snapshot", self._ground.snapshot())


def test_the_only_advised_action_is_approved_without_its_number() -> None:
    """As soon as the refresh has arrived with which the full state of the agent ends."""
    slow = SlowAgent({0.2: REFRESH, 1.0: FIRST, 1.5: REFRESH})
    assert slow.client.only_advice().params == (2, 17)
    assert 1.5 <= slow.took_s < 2.0


@pytest.mark.parametrize("second_s", [1.5, 20.0])
def test_an_action_that_arrives_later_must_be_chosen_by_its_number(second_s: float) -> None:
    """A radio may send it seconds after the first one: it is not the only one, and neither is approved."""
    slow = SlowAgent({0.2: REFRESH, 1.0: FIRST, second_s: SECOND, 40.0: REFRESH})
    with pytest.raises(click.UsageError, match="choose one by its number: 17: restart ros_app; 18: relaunch node_1"):
        slow.client.only_advice()


def test_an_action_of_an_incomplete_state_must_be_chosen_by_its_number() -> None:
    """Without the refresh, more actions may be advised than have arrived."""
    slow = SlowAgent({0.2: REFRESH, 1.0: FIRST})
    with pytest.raises(click.UsageError, match=r"may advise more than has arrived.*by its number: 17: restart ros_app"):
        slow.client.only_advice()


def test_without_advice_nothing_is_approved() -> None:
    """After the time in which an agent sends its full state."""
    with pytest.raises(click.ClickException, match="no recommended action of A05 was received"):
        SlowAgent({0.2: REFRESH}).client.only_advice()
