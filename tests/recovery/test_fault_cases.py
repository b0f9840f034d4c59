"""The open faults of one container."""

from __future__ import annotations

import threading
from collections.abc import Iterable

from phm.api import Layer, Slot, error
from phm.core.model import Fault, Stamp
from phm.recovery.fault_cases import FaultCases


def fault(name: str, condition: str = "broken", target: str = "app") -> Fault:
    found = error("bad", brief="bad", condition=condition, target=target)
    return Fault(name, f"health/{name}", Slot.CONTAINER, Layer.DOCKER, found, Stamp(0.0, 0.0))


def test_closed_faults_are_forgotten() -> None:
    """Only what the tracker still has open is left."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    cases.opened(fault("b"))
    assert [case.fault.id for case in cases.current(lambda: [fault("b")])] == ["b"]
    assert cases.find("a") is None


def test_a_case_follows_the_condition_of_its_fault() -> None:
    """What is wrong may have changed, and its event may be on its way; what was refused was the action for another fault."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    (case,) = cases.current(lambda: [fault("a")])
    case.refused = True
    assert cases.current(lambda: [fault("a")])[0].refused
    (case,) = cases.current(lambda: [fault("a", "other")])
    assert (case.fault.result.condition, case.refused) == ("other", False)


def test_a_fault_that_no_longer_concerns_the_container_is_forgotten() -> None:
    """A hung node that turns out to be unreachable has no target: nothing is restarted for it."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    assert cases.current(lambda: [fault("a", "node_unreachable", target="")]) == []


def test_a_fault_that_opens_while_others_are_looked_through_is_kept() -> None:
    """It comes by another thread, after the tracker was asked: forgotten now, it would never be healed."""
    cases, came = FaultCases("app"), threading.Event()
    coming = threading.Thread(target=lambda: (cases.opened(fault("new")), came.set()))

    def open_faults() -> Iterable[Fault]:
        coming.start()
        came.wait(0.2)  # for as long as it may come at all
        return []

    assert cases.current(open_faults) == []
    coming.join()
    assert cases.find("new") is not None
