"""Readiness in the child: which services have a server, states of lifecycle nodes, and answers of services without request fields.

`get_state` changes nothing in a node; of the other services only those are called for which the configuration asks. Nothing here waits: a
call is sent in one poll, and its answer is read in a later one.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any

from phm.facts.ros import AnswerFact
from phm.probes.ros.message_types import UnknownType, load_decodable
from phm.probes.ros.protocol import Message, ReadinessUpdate, Wanted, WantedCall

STATES: Mapping[int, str] = {
    1: "unconfigured",
    2: "inactive",
    3: "active",
    4: "finalized",
    10: "configuring",
    11: "cleaningup",
    12: "shuttingdown",
    13: "activating",
    14: "deactivating",
    15: "errorprocessing",
}
"""lifecycle_msgs/msg/State. The text of a state is not used: it comes from another participant."""
UNKNOWN = "unknown"
STATE_S = 1.0
"""Time between two calls of one `get_state`."""
CHANGED_S = 0.2
"""The same for `get_state` after a change of the graph, which may follow from a transition."""
ANSWER_S = 2.0
"""A call without an answer for this long is repeated."""
STALL_S = 0.5
"""The most of the time between two polls that counts as unanswered: in the rest the child did not run."""
MAX_ANSWERS = 10
"""Answers read from one service per poll."""
MAX_TEXT = 255
FULL_S = 1.0
"""Time between two messages without a change."""
_MISSING = "{0} is not installed beside PHM: install it where rclpy comes from (ros-<distro>-{1})"
NOT_LISTED = "the ROS domain has a service whose name is not UTF-8, and ROS 2 Humble then lists none"

Answer = tuple[str, str]
"""`AnswerFact.answer` and `.detail`."""


class ReadinessReader:
    """Reads what `Wanted.services`, `.lifecycle` and `.calls` name; costs nothing where all are empty."""

    def __init__(self, node: Any, wanted: Wanted) -> None:
        self._node = node
        self._services = wanted.services
        self._states = {name: _lifecycle(node, name) for name in wanted.lifecycle}
        self._calls = {call.service: (_called(node, call), call.period_s) for call in wanted.calls}
        self._used = bool(wanted.services or wanted.lifecycle or wanted.calls)
        self._reported: ReadinessUpdate | None = None
        self._due_s = 0.0

    def poll(self, now_s: float, *, graph_changed: bool) -> list[Message]:
        """Return the message for the daemon, after a change or when one is due; called once per tick."""
        if not self._used:
            return []
        update = ReadinessUpdate(
            {name: servers(self._node, name) for name in self._services},
            {name: call.poll(now_s, CHANGED_S if graph_changed else STATE_S) for name, call in self._states.items()},
            {name: call.poll(now_s, period_s) for name, (call, period_s) in self._calls.items()},
        )
        if update == self._reported and now_s < self._due_s:
            return []
        self._reported, self._due_s = update, now_s + FULL_S
        return [update]


class RepeatedCall:
    """A service that is called again and again by a client that is in no executor."""

    def __init__(
        self, node: Any, service: str, kind: Any, read: Callable[[Any], Answer], repeat_s: float = ANSWER_S
    ) -> None:
        """kind: the class of the service. read: what to keep of a response. repeat_s: a call without an answer for this long
        is repeated."""
        self._node, self._service, self._kind, self._read, self._repeat_s = node, service, kind, read, repeat_s
        self._client = node.create_client(kind, service)
        self._fact = AnswerFact()
        self._called_s: float | None = None
        """When the open call was sent; None: none is open."""
        self._last_called_s = self._polled_s = float("-inf")

    def poll(self, now_s: float, rest_s: float) -> AnswerFact:
        """Read answers, and call again if the last call was `rest_s` ago."""
        passed_s, self._polled_s = min(STALL_S, now_s - self._polled_s), now_s
        count = servers(self._node, self._service)
        if not count and not (count is None and self._client.service_is_ready()):
            # A server that returns may be another process, so the old answer does not count.
            self._called_s, self._fact = None, AnswerFact(problem=NOT_LISTED if count is None else "")
            return self._fact
        answer = self._newest()
        if answer is not None:
            self._called_s, self._fact = None, AnswerFact(*answer, served=True)
        else:
            before = self._fact
            waiting = self._called_s is not None or before.unanswered_s > 0 or not before.answer
            unanswered_s = round(before.unanswered_s + (passed_s if waiting else 0.0), 3)
            self._fact = AnswerFact(before.answer, before.detail, served=True, unanswered_s=unanswered_s)
        self._call(now_s, rest_s)
        return self._fact

    def _newest(self) -> Answer | None:
        """The newest answer that was received; None: none was."""
        answer = None
        handle = self._client.handle
        with handle:
            for _ in range(MAX_ANSWERS):
                try:
                    _, response = handle.take_response(self._kind.Response)
                except Exception:  # exceptions of rclpy and pybind: what was sent is not an answer
                    break
                if response is None:
                    break
                answer = self._read(response)
        return answer

    def _call(self, now_s: float, rest_s: float) -> None:
        if now_s - self._last_called_s < (rest_s if self._called_s is None else self._repeat_s):
            return
        if not self._client.service_is_ready():
            return
        handle = self._client.handle
        with handle:
            handle.send_request(self._kind.Request())
        self._called_s = self._last_called_s = now_s


class _Impossible:
    """A call that cannot be made, with the reason."""

    def __init__(self, problem: str) -> None:
        self._fact = AnswerFact(problem=problem[:MAX_TEXT])

    def poll(self, now_s: float, rest_s: float) -> AnswerFact:
        return self._fact


def servers(node: Any, service: str) -> int | None:
    """How often discovery lists a server of the service; None: unknown."""
    count = getattr(node, "count_services", None)
    try:
        if count is not None:
            return int(count(service))
        # Humble
        return sum(1 for name, _ in node.get_service_names_and_types() if name == service)
    except Exception:  # a name that ROS refuses, or, in Humble, one of another participant that is not UTF-8
        return None if count is None else 0


def _lifecycle(node: Any, name: str) -> RepeatedCall | _Impossible:
    def read(response: Any) -> Answer:
        return STATES.get(response.current_state.id, UNKNOWN), ""

    service = f"{name}/get_state"
    try:
        kind = importlib.import_module("lifecycle_msgs.srv").GetState
        return RepeatedCall(node, service, kind, read)
    except ImportError:
        return _Impossible(_MISSING.format("lifecycle_msgs", "lifecycle-msgs"))
    except Exception as error:  # exceptions of rclpy and pybind, e.g. for a name that ROS refuses
        return _Impossible(str(error))


def _called(node: Any, wanted: WantedCall) -> RepeatedCall | _Impossible:
    """A service whose request has no fields. Of the response, `success` and `message` count, where it has them."""

    def read(response: Any) -> Answer:
        succeeded = getattr(response, "success", True) is not False
        return "true" if succeeded else "false", str(getattr(response, "message", ""))[:MAX_TEXT]

    package = wanted.kind.partition("/")[0]
    try:
        kind = load_decodable(wanted.kind)
        if fields := kind.Request.get_fields_and_field_types():
            return _Impossible(
                f"{wanted.kind} has a request with fields ({', '.join(fields)}): PHM sends only empty requests"
            )
        return RepeatedCall(node, wanted.service, kind, read, wanted.repeat_s)
    except UnknownType:
        return _Impossible(_MISSING.format(package, package.replace("_", "-")))
    except Exception as error:  # as above
        return _Impossible(str(error))
