"""Peers and helpers for MAVLink tests: real pymavlink codecs and sockets on loopback."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable, Set
from typing import Any

from phm.facts import LinkFact
from phm.transport.dialect import mavlink
from phm.transport.priority import MessagePriority
from phm.wire import tunnel
from phm.wire.command import REPLY_TEXT

LIMIT_S = 60.0


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port of loopback that is not in use."""
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def heartbeat(
    custom_mode: int = 0, *, kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, autopilot: int = 8, base_mode: int = 0
) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, base_mode, custom_mode, 4, 3)


def text(words: str, severity: int = 6) -> Any:
    return mavlink.MAVLink_statustext_message(severity, words.encode())


def is_reply(message: Any) -> bool:
    """Whether it is the text that follows the acknowledgement of a command."""
    if message.get_type() != "TUNNEL":
        return False
    part = tunnel.decode(bytes(message.payload[: message.payload_length]))
    return isinstance(part, tunnel.FaultDetail) and part.fault == REPLY_TEXT


class Sender:
    """Another MAVLink program: packs frames with its own identity and sequence."""

    def __init__(self, system: int, component: int) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def frame(self, message: Any, *, v1: bool = False) -> bytes:
        packed: bytes = message.pack(self._mav, force_mavlink1=v1)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def received(self, message: Any) -> Any:
        """The message, decoded as by a receiver."""
        return mavlink.MAVLink(None).decode(bytearray(self.frame(message)))


class FakePort:
    """A `MavlinkPort` that records sent messages, and receives what the test injects."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self._listeners: list[tuple[Callable[[Any, str], None], frozenset[int]]] = []

    agents = 1
    to: Callable[[Any, MessagePriority, str, int], None] | None = None
    """Where messages go as well, e.g. into an outbox."""

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
        only_while: tuple[str, ...] = (),
        only_replace: bool = False,
    ) -> None:
        if only_replace:
            return  # nothing waits here
        self.sent.append(message)
        if self.to is not None:
            self.to(message, kind, key, urgency)

    def set_true(self, names: Set[str]) -> None:
        """Not used: nothing waits here."""

    def links(self) -> tuple[LinkFact, ...]:
        return ()

    def listen(self, callback: Callable[[Any, str], None], ids: Iterable[int]) -> None:
        self._listeners.append((callback, frozenset(ids)))

    def receive(self, message: Any) -> None:
        for callback, ids in self._listeners:
            if message.get_msgId() in ids:
                callback(message, "test")

    def lines(self) -> list[tuple[int, str]]:
        """Severity and text of the STATUSTEXTs since the last call; clears them."""
        found = [(message.severity, message.text) for message in self.sent if message.get_type() == "STATUSTEXT"]
        self.sent.clear()
        return found

    def heartbeats(self) -> list[Any]:
        """HEARTBEATs since the last call; clears them."""
        found = [message for message in self.sent if message.get_type() == "HEARTBEAT"]
        self.sent.clear()
        return found
