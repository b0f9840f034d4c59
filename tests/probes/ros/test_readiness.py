"""Servers and answers of services as the ROS child process reports them, without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phm.facts import AnswerFact
from phm.probes.ros.protocol import Wanted, decode, encode
from phm.probes.ros.readiness import NOT_LISTED, ReadinessReader, RepeatedCall, servers

SERVICE = "/map_server/reset"


class Humble:
    """A node of a distribution without `count_services`. listed: names of services; None: one of them is not UTF-8."""

    def __init__(self, listed: list[str] | None) -> None:
        self.listed = listed
        self.client = Client()

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        if self.listed is None:
            raise UnicodeDecodeError("utf-8", b"/caf\xe9", 4, 5, "invalid continuation byte")
        return [(name, []) for name in self.listed]

    def create_client(self, kind: Any, service: str) -> Client:
        return self.client


class Client:
    """A client whose server, if it is `ready`, answers at the next poll."""

    def __init__(self) -> None:
        self.ready, self.sent = False, 0

    @property
    def handle(self) -> Client:
        return self

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def service_is_ready(self) -> bool:
        return self.ready

    def send_request(self, request: object) -> None:
        self.sent += 1

    def take_response(self, kind: object) -> tuple[None, object]:
        response, self.sent = (object() if self.sent else None), 0
        return None, response


class Newer(Humble):
    """A node that counts, and refuses names as ROS does."""

    def count_services(self, service: str) -> int:
        if "-" in service:
            raise ValueError("invalid service name")
        return (self.listed or []).count(service)


@pytest.mark.parametrize(
    ("node", "service", "count"),
    [
        (Humble([SERVICE, "/other", SERVICE]), SERVICE, 2),
        (Humble([]), SERVICE, 0),
        (Humble(None), SERVICE, None),
        (Newer([SERVICE]), SERVICE, 1),
        (Newer(None), SERVICE, 0),
        (Newer([]), "/map-server", 0),
    ],
)
def test_servers_are_counted_or_unknown(node: Any, service: str, count: int | None) -> None:
    """In Humble a name of any participant that is not UTF-8 hides all services: no server is missed for that."""
    assert servers(node, service) == count
    (update,) = ReadinessReader(node, Wanted("A01", services=(service,))).poll(0.0, graph_changed=False)
    assert decode(encode(update)) == update


def test_a_service_is_called_while_its_servers_cannot_be_listed() -> None:
    """Its client knows the server, too. Without it, whether the service has one is unknown."""
    node = Humble(None)
    kind = SimpleNamespace(Request=object, Response=object)
    call = RepeatedCall(node, SERVICE, kind, lambda response: ("true", ""))
    assert call.poll(0.0, 1.0) == AnswerFact(problem=NOT_LISTED)
    node.client.ready = True
    assert call.poll(1.0, 1.0).served
    assert call.poll(2.0, 1.0) == AnswerFact("true", served=True)
    node.client.ready = False
    assert call.poll(3.0, 1.0) == AnswerFact(problem=NOT_LISTED)
    node.listed = []
    assert call.poll(4.0, 1.0) == AnswerFact()
