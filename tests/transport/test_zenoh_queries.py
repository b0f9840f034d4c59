"""What one turn of the link publishes and answers, without Zenoh."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from phm.core.settings import FleetSettings
from phm.testing import FakeClock
from phm.transport.zenoh_link import MAX_QUERIES, FleetKeys, ZenohLink


def connected(source: str = "a") -> Any:
    """A session with one connection, from this port."""
    return SimpleNamespace(info=SimpleNamespace(links=lambda: [SimpleNamespace(zid="z", src=source, dst="b")]))


def test_constant_queries_do_not_delay_the_status() -> None:
    """Each answer triggers the next query: a turn answers a limited number, and the next turn publishes first."""
    link = ZenohLink(FleetSettings(), FleetKeys("status", "alive", "namesakes"), FakeClock())
    done: list[str] = []

    def answer(query: object, payload: bytes) -> None:
        done.append("answer")
        link._asked(object())

    declared: Any = SimpleNamespace(
        present=lambda yes: None, publish=lambda payload: done.append(payload.decode()), answer=answer
    )
    link.present(True)
    link._asked(object())
    for number in range(3):
        link.put(f"status {number}".encode())
        link._turn(connected(), declared)
    assert [said for said in done if said != "answer"] == ["status 0", "status 1", "status 2"]
    assert 3 <= done.count("answer") <= 3 * MAX_QUERIES
    assert link._bell.is_set()


def test_a_connection_that_returns_while_checks_hang_publishes_nothing() -> None:
    """An old status would look like a new one. It is published again once checks return, as after any new connection."""
    link = ZenohLink(FleetSettings(), FleetKeys("status", "alive", "namesakes"), FakeClock())
    done: list[str] = []
    declared: Any = SimpleNamespace(present=lambda yes: None, publish=lambda payload: done.append(payload.decode()))
    link.present(True)
    link.put(b"status")
    link._turn(connected(), declared)
    link.present(False)
    link._turn(connected("new port"), declared)
    assert done == ["status"]
    link.present(True)
    link._turn(connected("new port"), declared)
    assert done == ["status", "status"]
