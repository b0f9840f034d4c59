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
    """Only faults that the tracker still has open remain."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    cases.opened(fault("b"))
    assert [case.fault.id for case in cases.current(lambda: [fault("b")])] == ["b"]
    assert cases.find("a") is None


def test_a_case_follows_the_condition_of_its_fault() -> None:
    """The condition may have changed while its event is still queued; the refusal was for the earlier condition."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    (case,) = cases.current(lambda: [fault("a")])
    case.refused = True
    assert cases.current(lambda: [fault("a")])[0].refused
    (case,) = cases.current(lambda: [fault("a", "other")])
    assert (case.fault.result.condition, case.refused) == ("other", False)


def test_a_fault_that_no_longer_concerns_the_container_is_forgotten() -> None:
    """A hung node that becomes unreachable has no target: nothing is restarted for it."""
    cases = FaultCases("app")
    cases.opened(fault("a"))
    assert cases.current(lambda: [fault("a", "node_unreachable", target="")]) == []


def test_a_fault_that_opens_during_the_update_is_kept() -> None:
    """Another thread adds it after the tracker was queried: if it were forgotten, it would never be recovered."""
    cases, came = FaultCases("app"), threading.Event()
    coming = threading.Thread(target=lambda: (cases.opened(fault("new")), came.set()))

    def open_faults() -> Iterable[Fault]:
        coming.start()
        came.wait(0.2)  # waits as long as it can arrive at all
        return []

    assert cases.current(open_faults) == []
    coming.join()
    assert cases.find("new") is not None
