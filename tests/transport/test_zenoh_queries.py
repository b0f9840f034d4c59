"""Queries are answered without delaying publications."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from phm.core.settings import FleetSettings
from phm.testing import FakeClock
from phm.transport.zenoh_link import MAX_QUERIES, FleetKeys, ZenohLink


def test_constant_queries_do_not_delay_the_status() -> None:
    """Each answer triggers the next query: a turn answers a limited number, and the next turn publishes first."""
    link = ZenohLink(FleetSettings(), FleetKeys("status", "alive", "namesakes"), FakeClock())
    session: Any = SimpleNamespace(info=SimpleNamespace(links=lambda: [SimpleNamespace(zid="z", src="a", dst="b")]))
    done: list[str] = []

    def answer(query: object, payload: bytes) -> None:
        done.append("answer")
        link._asked(object())

    declared: Any = SimpleNamespace(
        present=lambda yes: None, publish=lambda payload: done.append(payload.decode()), answer=answer
    )
    link._asked(object())
    for number in range(3):
        link.put(f"status {number}".encode())
        link._turn(session, declared)
    assert [said for said in done if said != "answer"] == ["status 0", "status 1", "status 2"]
    assert 3 <= done.count("answer") <= 3 * MAX_QUERIES
    assert link._bell.is_set()
