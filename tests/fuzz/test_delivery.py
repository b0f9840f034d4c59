"""`phm deliver`: whatever either end says is read or refused, and nothing without the key is accepted."""

from __future__ import annotations

import contextlib
import json
from typing import Any

from phm.wire import delivery as wire
from phm.wire.delivery import DeliveryAnswer, Hello, NotADelivery
from tests.fuzz.hostile import messages
from tests.fuzz.targets import fuzzed

KEY = bytes(range(32))
SAID = Hello("A07", "ab" * 32)
REQUEST, SENT = wire.request(SAID, "cd" * 32, "agent: {id: 7}\n", KEY)
HEAD: dict[str, Any] = json.loads(SENT.partition(b"\n")[0])
HELLO = {"phm": "delivery", "v": 1, "agent": "A07", "nonce": "ab" * 32}
PROBLEM = {"line": 1, "key": "k", "message": "m", "text": "t"}
GOOD: dict[str, Any] = json.loads(wire.answer_line(DeliveryAnswer(True, "done", "ab" * 32, (PROBLEM,)), KEY, REQUEST))
INNER = messages({"ok": True, "text": "done", "present": "ab" * 32, "problems": [PROBLEM]})
ANSWERS = messages(GOOD) | INNER.map(
    lambda data: json.dumps({"answer": data.decode("utf-8", "replace"), "mac": "00" * 32}).encode()
)


@fuzzed("delivery request", line=messages(HEAD))
def test_no_changed_request_is_authentic(line: bytes) -> None:
    """Only the one that was signed."""
    with contextlib.suppress(NotADelivery):
        request = wire.read_request(line)
        assert wire.authentic(request, SAID, KEY) is (request == REQUEST)


@fuzzed("delivery hello", line=messages(HELLO))
def test_any_first_line_is_read_or_refused(line: bytes) -> None:
    """And can be answered."""
    with contextlib.suppress(NotADelivery):
        wire.request(wire.read_hello(line), "cd" * 32, "text", KEY)


@fuzzed("delivery answer", line=ANSWERS)
def test_no_changed_answer_is_a_success(line: bytes) -> None:
    """Only what the agent signed."""
    with contextlib.suppress(NotADelivery):
        answer = wire.read_answer(line, REQUEST, KEY)
        assert not answer.ok or answer == DeliveryAnswer(True, "done", "ab" * 32, (PROBLEM,))
