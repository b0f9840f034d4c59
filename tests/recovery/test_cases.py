"""The open faults of one container."""

from __future__ import annotations

import threading
from collections.abc import Iterable

from phm.api import Layer, Slot, error
from phm.model import Fault, Stamp
from phm.recovery.cases import Cases


def fault(name: str) -> Fault:
    found = error("bad", brief="bad", condition="broken", target="app")
    return Fault(name, f"health/{name}", Slot.CONTAINER, Layer.DOCKER, found, Stamp(0.0, 0.0))


def test_what_is_over_is_forgotten() -> None:
    """Only what the tracker still has open is left."""
    cases = Cases()
    cases.opened(fault("a"))
    cases.opened(fault("b"))
    assert [case.fault.id for case in cases.only(lambda: [fault("b")])] == ["b"]
    assert cases.find("a") is None


def test_a_fault_that_opens_while_others_are_looked_through_is_kept() -> None:
    """It comes by another thread, after the tracker was asked: forgotten now, it would never be healed."""
    cases, came = Cases(), threading.Event()
    coming = threading.Thread(target=lambda: (cases.opened(fault("new")), came.set()))

    def open_faults() -> Iterable[Fault]:
        coming.start()
        came.wait(0.2)  # for as long as it may come at all
        return []

    assert cases.only(open_faults) == []
    coming.join()
    assert cases.find("new") is not None
