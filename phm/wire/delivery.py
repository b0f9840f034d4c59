"""How an operator's configuration reaches an agent over TCP: the messages, and how both ends prove that they have the key. Pure.

One connection is one delivery; each message but the configuration itself is a JSON object on a line.

1. agent:    ``{"phm": "delivery", "v": 1, "agent": NAME, "nonce": HEX}``
2. operator: ``{"v": 1, "base": SHA256, "sha256": SHA256, "size": BYTES, "nonce": HEX, "mac": HEX}``, then the configuration
3. agent:    ``{"answer": TEXT, "mac": HEX}``; TEXT is a JSON object, see `DeliveryAnswer`

`mac` of the request is an HMAC with SHA-256 over both nonces, the agent's name, and what is delivered, so it is of use on this one
connection alone: a recording is worth nothing, and no clock is needed. `mac` of the answer covers that of the request. An answer
without one comes from an agent that does not know its sender.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

VERSION = 1
MAX_LINE = 2048
"""Bytes of the agent's first line, and of the request."""
MAX_ANSWER = 131_072
MAX_SIZE = 256 * 1024
"""Bytes of a configuration, as `phm.config.yaml_tree.MAX_BYTES`."""
MAX_PROBLEMS, MAX_TEXT = 100, 500
_HEX = re.compile(r"[0-9a-f]{64}")


class NotADelivery(Exception):
    """The other end sent something else; the message says what is wrong."""


@dataclass(frozen=True, slots=True)
class Hello:
    """The first line that the agent sends."""

    agent: str
    nonce: str


@dataclass(frozen=True, slots=True)
class Request:
    """base: version of the configuration that is replaced. version, size: of the one that follows; size 0: only the agent's version
    is asked for."""

    base: str
    version: str
    size: int
    nonce: str
    mac: str


@dataclass(frozen=True, slots=True)
class DeliveryAnswer:
    """text: one sentence. present: version of the agent's file now, empty if the agent does not say. trusted: it has the key.

    problems: each with `line`, `key`, `message` and `text`, as of `phm validate --json`.
    """

    ok: bool
    text: str
    present: str = ""
    problems: tuple[dict[str, Any], ...] = ()
    trusted: bool = field(default=False, compare=False)

    def as_json(self) -> str:
        """The answer as JSON, at most MAX_ANSWER bytes."""
        kept = [{name: _cut(value) for name, value in each.items()} for each in self.problems[:MAX_PROBLEMS]]
        while True:
            text = json.dumps({"ok": self.ok, "text": _cut(self.text), "present": self.present, "problems": kept})
            if len(text) <= MAX_ANSWER // 2:
                return text
            kept = kept[: len(kept) // 2]


def version_of(text: str) -> str:
    """The SHA-256 of a configuration's text."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


# ------------------------------------------------------------ the agent


def hello(agent: str) -> tuple[Hello, bytes]:
    """A new nonce, and the line that has it."""
    made = Hello(agent, secrets.token_hex(32))
    return made, _line({"phm": "delivery", "v": VERSION, "agent": agent, "nonce": made.nonce})


def read_request(line: bytes) -> Request:
    """The request in a received line. Raises NotADelivery."""
    document = _object(line)
    match document:
        case {
            "v": 1,
            "base": str(base),
            "sha256": str(version),
            "size": int(size),
            "nonce": str(nonce),
            "mac": str(mac),
        }:
            if len(document) == 6 and type(size) is int and all(map(_HEX.fullmatch, (base, version, nonce, mac))):
                return Request(base, version, size, nonce, mac)
    raise NotADelivery("this is not a request of `phm deliver`")


def authentic(request: Request, said: Hello, key: bytes) -> bool:
    """Whether its sender has the key, and answers this hello."""
    expected = _request_mac(key, said, request.base, request.version, request.size, request.nonce)
    return hmac.compare_digest(expected, request.mac)


def answer_line(answer: DeliveryAnswer, key: bytes | None = None, request: Request | None = None) -> bytes:
    """The answer as one signed line. Without key and request it is not signed: for a sender that has not proven to have the key."""
    text = answer.as_json()
    mac = _mac(key, ["phm delivery answer", request.mac, text]) if key is not None and request is not None else ""
    return _line({"answer": text, "mac": mac})


# ------------------------------------------------------------ the operator


def read_hello(line: bytes) -> Hello:
    """The greeting in a received line. Raises NotADelivery."""
    match document := _object(line):
        case {"phm": "delivery", "v": 1, "agent": str(agent), "nonce": str(nonce)} if _HEX.fullmatch(nonce):
            return Hello(agent, nonce)
        case {"phm": "delivery"}:
            raise NotADelivery("it runs another version of PHM")
        case {"answer": str()}:
            raise NotADelivery(_answer(document, trusted=False).text)
    raise NotADelivery("it is not PHM's port for configurations (`delivery.listen`)")


def request(said: Hello, base: str, text: str, key: bytes) -> tuple[Request, bytes]:
    """The request, and all bytes that are sent."""
    body, nonce = text.encode("utf-8"), secrets.token_hex(32)
    version = version_of(text)
    mac = _request_mac(key, said, base, version, len(body), nonce)
    line = {"v": VERSION, "base": base, "sha256": version, "size": len(body), "nonce": nonce, "mac": mac}
    return Request(base, version, len(body), nonce, mac), _line(line) + body


def read_answer(line: bytes, sent: Request, key: bytes) -> DeliveryAnswer:
    """An answer of someone without the key is never `ok`. Raises NotADelivery."""
    match document := _object(line):
        case {"answer": str(text), "mac": str(mac)}:
            trusted = hmac.compare_digest(
                _mac(key, ["phm delivery answer", sent.mac, text]).encode(), mac.encode("utf-8", "surrogatepass")
            )
            return _answer(document, trusted=trusted)
    raise NotADelivery("the response is not from PHM")


# ------------------------------------------------------------ inside


def _answer(document: Mapping[str, Any], *, trusted: bool) -> DeliveryAnswer:
    match _object(document["answer"]):
        case {"ok": bool(ok), "text": str(text), "present": str(present), "problems": list(problems)}:
            kept = tuple(each for each in problems[:MAX_PROBLEMS] if _is_problem(each))
            if not trusted:
                return DeliveryAnswer(
                    False, f"response not authenticated with the key; it may not be from the agent: {text}"[:MAX_TEXT]
                )
            return DeliveryAnswer(ok, text[:MAX_TEXT], present if _HEX.fullmatch(present) else "", kept, True)
    raise NotADelivery("the response is not from PHM")


def _is_problem(each: object) -> bool:
    match each:
        case {"line": int(), "key": str(), "message": str(), "text": str()}:
            return True
    return False


def _request_mac(key: bytes, said: Hello, base: str, version: str, size: int, nonce: str) -> str:
    return _mac(key, ["phm delivery request", VERSION, said.agent, said.nonce, nonce, base, version, size])


def _mac(key: bytes, words: list[object]) -> str:
    """JSON, so that no two lists of words are the same bytes."""
    return hmac.new(key, json.dumps(words).encode("ascii"), "sha256").hexdigest()


def _object(data: bytes | str) -> dict[str, Any]:
    """The JSON object in a line; empty for anything else."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def _line(document: Mapping[str, object]) -> bytes:
    return json.dumps(document).encode("ascii") + b"\n"


def _cut(value: Any) -> Any:
    return value if not isinstance(value, str) or len(value) <= MAX_TEXT else f"{value[: MAX_TEXT - 3]}..."
