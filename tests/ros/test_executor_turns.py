"""Whether the executor of a node ran, by the number of its turns that its beacon reports."""

from __future__ import annotations

import json

from phm.beacon import BEACON_FORMAT
from phm.probes.ros.beacon_registry import BeaconRegistry

A = "/agent_1/a"
VIEWS = {"/agent_1/b": {"alive": True, "age_s": 0.4, "late_s": 0.0}}


def ran_since(book: BeaconRegistry, at_s: float, turns: int, birth: str = "w.1") -> float | None:
    """What is known of A after a beacon with this number of turns. It lists neighbours, so all of it is reported."""
    node = {"birth": birth, "beats": 5, "turns": turns, "late_s": 0.0}
    said = {"witness": "w", "period_s": 0.2, "nodes": {A: node}, "views": VIEWS}
    book.add(BEACON_FORMAT, json.dumps(said), at_s)
    update = book.changes(at_s)
    assert update is not None
    return update.beacons[A].ran_since


def test_the_number_of_turns_shows_since_when_an_executor_has_run_twice() -> None:
    """A turn that a beacon counts first came after the beacon before it."""
    book = BeaconRegistry(frozenset({A}))
    seen = [
        ran_since(book, at_s, turns) for at_s, turns in ((1.0, 3), (2.0, 4), (3.0, 4), (4.0, 5), (5.0, 6), (9.0, 8))
    ]
    assert seen == [None, None, None, 1.0, 3.0, 5.0]


def test_an_executor_that_does_not_run_gets_no_newer_time() -> None:
    """However punctual its process says that it is; a new process begins again."""
    book = BeaconRegistry(frozenset({A}))
    assert [ran_since(book, at_s, turns) for at_s, turns in ((1.0, 3), (2.0, 5), (3.0, 5), (30.0, 5))][1:] == [1.0] * 3
    assert ran_since(book, 31.0, 1, birth="w.2") is None
    assert ran_since(book, 32.0, 2, birth="w.2") is None
