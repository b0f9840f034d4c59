"""What an operator may request by the control socket, and the reply to any request. What MAVLink adds is `phm.wire.command`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from phm.wire.command import ApproveAction, CommandResult, PlaceRequest, RunChecks
from phm.wire.text import one_line

MAX_NOTE = 500


@dataclass(frozen=True, slots=True)
class Ping:
    """A request that asks whether PHM answers."""


@dataclass(frozen=True, slots=True)
class AddNote:
    """Write a line into the log."""

    text: str


@dataclass(frozen=True, slots=True)
class HoldContainer:
    """Keep recovery from a container; empty: from all. for_s: seconds, None for the configured length."""

    container: str
    for_s: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class ReleaseContainer:
    """End the hold of a container; empty: all holds."""

    container: str


@dataclass(frozen=True, slots=True)
class Reload:
    """Read the configuration again."""


SocketRequest = Ping | AddNote | HoldContainer | ReleaseContainer | Reload | ApproveAction
OperatorRequest = SocketRequest | RunChecks | PlaceRequest


@dataclass(frozen=True, slots=True)
class Reply:
    """result: for COMMAND_ACK. text: one sentence. data: more for `--json`."""

    result: CommandResult
    text: str
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        return self.result is CommandResult.ACCEPTED


def parse(document: Any) -> SocketRequest:
    """A request from its JSON object (`phm.wire.control`). Raises ValueError when it is not one."""
    if not isinstance(document, dict):
        raise ValueError("not a JSON object")
    fields = {key: value for key, value in document.items() if key != "do"}
    match document.get("do"), fields:
        case "ping", {**rest} if not rest:
            return Ping()
        case "reload", {**rest} if not rest:
            return Reload()
        case "approve", {"fault": str(fault), **rest} if not rest:
            return ApproveAction(fault)
        case "note", {"text": str(text), **rest} if not rest:
            return AddNote(one_line(text)[:MAX_NOTE])
        case "release", {"container": str(container), **rest} if not rest:
            return ReleaseContainer(container)
        case "hold", {
            "container": str(container),
            "for_s": None | int() | float() as for_s,
            "reason": str(reason),
            **rest,
        } if not rest and not isinstance(for_s, bool):
            return HoldContainer(container, for_s, reason)
    raise ValueError("unknown request")
