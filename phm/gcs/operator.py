"""Requests of the operator to an agent, and the agent's answers. Pure; the caller brings time."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from phm.gcs.events import GcsEvent
from phm.wire.command import (
    APPROVE,
    CHECK,
    CONTAINERS,
    HOLD,
    LARGEST,
    NAMED_VALUE_FLOAT,
    ONBOARD_COMPUTER_STATUS,
    RELEASE,
    REPLY_TEXT,
    REQUEST_MESSAGE,
    RESTART,
    SET_MESSAGE_INTERVAL,
    TUNNEL,
    USER_1,
    container_hash,
)

RESEND_S, ATTEMPTS = 1.5, 4
"""An unanswered command is sent again, with a higher `confirmation`: an agent does not execute it twice."""
REPLY_S = 2.0
"""The text of an answer follows its COMMAND_ACK within this time; an older PHM sends none."""
HINTS = {
    "DENIED": "not among mavlink.commands on board, or not signed with the key of the agents (--key)",
    "TEMPORARILY_REJECTED": "not possible now; see the agent's log",
    "UNSUPPORTED": "this version of PHM does not know the request",
    "FAILED": "there is nothing to do, or recovery is not allowed there; see the agent's log",
}
"""Explanations of a result, used where the agent sends no text."""


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """A MAVLink command. text: for the operator. name_hash: param3, of the container's name; 0: none. for_s: param4,
    the seconds of a hold; 0: as configured on board."""

    text: str
    command: int
    params: tuple[float, float]
    name_hash: int = 0
    for_s: float = 0.0

    @property
    def has_reply(self) -> bool:
        """Whether a text follows the COMMAND_ACK."""
        return self.command == USER_1


def run_checks() -> OperatorCommand:
    return OperatorCommand("run all checks", USER_1, (CHECK, 0))


def approve(fault: int, what: str = "") -> OperatorCommand:
    """Approve the advised action for a fault. fault: its number. what: the action."""
    return OperatorCommand(f"approve #{fault}{f' {what}' if what else ''}", USER_1, (APPROVE, fault))


def restart(place: int, name: str = "") -> OperatorCommand:
    """place: position of the container in the configuration, from 1. name: the agent refuses if another one is there; empty: any."""
    text = f"restart {name or f'container {place}'}"
    return OperatorCommand(text, USER_1, (RESTART, place), container_hash(name) if name else 0)


def hold(place: int, name: str, for_s: float | None = None) -> OperatorCommand:
    """Hold a container. for_s: seconds; None: as configured on board."""
    text = f"hold {name}{f' for {for_s:g} s' if for_s else ''}"
    return OperatorCommand(text, USER_1, (HOLD, place), container_hash(name), for_s or 0.0)


def release(place: int, name: str) -> OperatorCommand:
    return OperatorCommand(f"release {name}", USER_1, (RELEASE, place), container_hash(name))


def details(fault: int) -> OperatorCommand:
    return OperatorCommand(f"details of #{fault}" if fault else "details", REQUEST_MESSAGE, (TUNNEL, fault))


def report_load(every_s: float) -> OperatorCommand:
    """Have it send CPU, memory and temperature; 0: no longer."""
    text = f"report load every {every_s:g} s" if every_s else "stop reporting load"
    interval_us = every_s * 1e6 or -1.0
    return OperatorCommand(text, SET_MESSAGE_INTERVAL, (ONBOARD_COMPUTER_STATUS, interval_us))


def report_rates(every_s: float) -> OperatorCommand:
    """Have it send the rates of its topics; 0: no longer."""
    text = f"report topic rates every {every_s:g} s" if every_s else "stop reporting topic rates"
    return OperatorCommand(text, SET_MESSAGE_INTERVAL, (NAMED_VALUE_FLOAT, every_s * 1e6 or -1.0))


def list_containers() -> OperatorCommand:
    return OperatorCommand("list containers", REQUEST_MESSAGE, (TUNNEL, CONTAINERS))


def menu(agent: Mapping[str, Any]) -> list[tuple[str, OperatorCommand]]:
    """What can be requested of an agent, with the text to choose from. agent: of a snapshot."""
    found = [("run all checks", run_checks())]
    for one in agent["advice"]:
        what = f"{one['action']} {one['target']}".strip()
        valid = "" if one["valid_s"] is None else f", an approval is valid for {one['valid_s']:g} s"
        found.append((f"approve {what} (fault #{one['fault']}{valid})", approve(one["fault"], what)))
    for place, name in enumerate(agent["containers"], 1):
        found.append((f"restart {name}", restart(place, name)))
    return found


class Exchange:
    """One command to one agent until its answer. Not thread-safe.

    send: sends the command with this `confirmation` and nonce. name: of the agent, as in events.
    """

    def __init__(self, name: str, command: OperatorCommand, send: Callable[[int, float], None], now: float) -> None:
        self.name, self.command, self._send = name, command, send
        self.result = ""
        """Name of the MAV_RESULT; `TIMEOUT` without an answer."""
        self.late = False
        """Whether the answer arrived after the command was given up."""
        self.reply = ""
        self._attempts, self._at = 1, now
        self._nonce = float(secrets.randbelow(LARGEST))
        """Distinguishes it from an equal request before, which a repetition of this one must not be taken for."""
        self._send(0, self._nonce)

    def blocks(self, name: str, command: OperatorCommand) -> bool:
        """Whether this command to this agent must wait for the answer: a COMMAND_ACK names the command's number alone."""
        return (self.name, self.command.command) == (name, command.command)

    @property
    def accepted(self) -> bool:
        return self.result == "ACCEPTED"

    def receive(self, event: GcsEvent, now: float) -> None:
        """Take an event of the station."""
        body = event.body
        if body.get("name") != self.name:
            return
        if event.event == "ack" and body["command"] == self.command.command and self.result in ("", "TIMEOUT"):
            self.late = self.result == "TIMEOUT"
            self.result, self._at = body["result"], now
        elif event.event == "detail" and body["fault"] == REPLY_TEXT:
            self.reply = body["text"]

    def done(self, now: float) -> bool:
        """Whether the answer is complete, or none is expected any more; sends the command again when it is time."""
        if self.result:
            return bool(self.reply) or not self.command.has_reply or now - self._at >= REPLY_S
        if now - self._at >= RESEND_S:
            if self._attempts >= ATTEMPTS:
                self.result = "TIMEOUT"
                self._at = float("-inf")
                return True
            self._send(self._attempts, self._nonce)
            self._attempts, self._at = self._attempts + 1, now
        return False

    def answer(self) -> str:
        """The result in one sentence, for the operator."""
        head = f"{self.name} {self.command.text}: "
        if self.result == "TIMEOUT":
            return f"{head}no answer within {ATTEMPTS * RESEND_S:g} s"
        text = self.reply or HINTS.get(self.result, "")
        return f"{head}{self.result.lower().replace('_', ' ')}{f': {text}' if text else ''}"
