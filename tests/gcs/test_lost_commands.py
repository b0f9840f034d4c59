"""Requests of the operator whose frames are lost on the radio: the ground station's exchange with the agent's handler."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from phm.core.model import Stamp
from phm.gcs import operator
from phm.gcs.events import GcsEvent
from phm.gcs.operator import RESEND_S, Exchange
from phm.gcs.station import GroundStation
from phm.testing import FakeClock, settings
from phm.wire.command import CommandResult
from tests.commands.test_mavlink_commands import Scene
from tests.fakes.mavlink import Sender


class Holds:
    """The agent's holds; `did` has what was executed."""

    def __init__(self) -> None:
        self.did: list[str] = []

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]:
        self.did.append(f"hold {container}")
        return "on hold", {}

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]:
        self.did.append(f"release {container}")
        return "released", {}


class Radio:
    """A ground station and agent 7. Of the frames in either direction the first ones are lost, as many as a request says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.agent, self.holds = Scene("hold"), Holds()
        handler = self.agent.handler._handler
        monkeypatch.setattr(handler, "_services", dataclasses.replace(handler._services, holds=self.holds))
        self._station = GroundStation(settings().mavlink, 254, FakeClock())
        monkeypatch.setattr(self._station, "_hub", SimpleNamespace(send=self._send))
        self._ground = Sender(254, 190)
        self._lost = self._answers_lost = 0
        self._answers: list[Any] = []

    def _send(self, message: Any, *, link: str) -> None:
        if self._lost:
            self._lost -= 1
            return
        sent = self.agent.ask(message, by=self._ground)
        if self._answers_lost:
            self._answers_lost -= 1
            return
        self._answers += [one for one in sent if one.get_type() == "COMMAND_ACK"]

    def begin(self, command: operator.OperatorCommand, lost: int = 0, answers_lost: int = 0) -> Exchange:
        self._lost, self._answers_lost = lost, answers_lost

        def send(confirmation: int, nonce: float) -> None:
            self._station.command(7, 193, command, confirmation, nonce)

        return Exchange("A07", command, send, self.agent.clock.mono())

    def end(self, exchange: Exchange) -> str:
        """Its result, when the agent has answered."""
        while not exchange.result:
            for ack in self._answers:
                body = {"name": "A07", "command": ack.command, "result": CommandResult(ack.result).name}
                exchange.receive(GcsEvent(Stamp(0, 0), "ack", body), self.agent.clock.mono())
            self._answers.clear()
            exchange.done(self.agent.clock.mono())
            self.agent.clock.advance(RESEND_S / 2)
        return exchange.result

    def request(self, command: operator.OperatorCommand, lost: int = 0, answers_lost: int = 0) -> str:
        return self.end(self.begin(command, lost, answers_lost))


@pytest.fixture
def radio(monkeypatch: pytest.MonkeyPatch) -> Radio:
    return Radio(monkeypatch)


def test_a_request_that_is_made_again_is_executed_again(radio: Radio) -> None:
    """Its first frame is lost, so only a repetition arrives: it repeats this request, and not the equal one before."""
    for command, lost in ((operator.hold(1, "app"), 0), (operator.release(1, "app"), 0), (operator.hold(1, "app"), 1)):
        assert radio.request(command, lost) == "ACCEPTED"
    assert radio.holds.did == ["hold app", "release app", "hold app"]


def test_a_request_whose_answer_is_lost_is_executed_once(radio: Radio) -> None:
    """Its repetitions carry the same number."""
    assert radio.request(operator.hold(1, "app"), answers_lost=2) == "ACCEPTED"
    assert radio.holds.did == ["hold app"]


def test_a_request_to_another_agent_does_not_renew_a_repetition(radio: Radio) -> None:
    """One ground station has several exchanges at a time."""
    first = radio.begin(operator.hold(1, "app"), answers_lost=1)
    radio.begin(operator.release(1, "app"), lost=1)
    assert radio.end(first) == "ACCEPTED"
    assert radio.holds.did == ["hold app"]
