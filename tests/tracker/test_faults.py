"""What a fault takes from the unit that failed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm.core.model import Evidence
from tests.fakes.tracker_bench import BAD, OK, Bench, unit


def test_a_fault_names_the_node_of_its_unit() -> None:
    """Recovery learns from it which node `relaunch` starts."""
    bench = Bench([unit("rates", node="/a/camera")])
    bench.see("rates", BAD)
    assert [fault.node for fault in bench.tracker.open_faults()] == ["/a/camera"]


def test_a_restored_fault_names_the_node_of_the_present_configuration() -> None:
    """The state file has no node: the configuration may have changed meanwhile."""
    bench = Bench([unit("rates", node="/a/camera")])
    bench.see("rates", BAD)
    (fault,) = bench.tracker.open_faults()
    later = Bench([unit("rates", node="/a/other")])
    later.tracker.restore([replace(fault, node="")], (), later.stamp())
    assert [fault.node for fault in later.tracker.open_faults()] == ["/a/other"]


def test_a_number_of_an_earlier_run_is_not_used_again() -> None:
    """The ground approves by the number alone: two open faults with one, or an earlier line with that of another fault."""
    before = Bench([unit("a"), unit("b"), unit("c")])
    for name in "abc":
        before.see(name, BAD)
    before.see("c", OK)
    kept, tracker = before.tracker.open_faults(), before.tracker
    numbers = [fault.id for fault in kept]
    later = Bench([unit("a"), unit("b"), unit("c")])
    later.tracker.restore(kept, (), later.stamp(), tracker.fault_count)
    later.see("c", BAD)
    assert [fault.id for fault in later.tracker.open_faults()] == [*numbers, "F4"]


@pytest.mark.parametrize(
    ("count", "kept", "following"),
    [(0, 3, 4), (-1, 3, 4), (2, 3, 4), (7, 3, 8), (0, 10**8, 1), (10**9, 1, 2), (10**9, 3, 1)],
)
def test_numbers_of_restored_faults_are_left_out_whatever_the_count_is(count: int, kept: int, following: int) -> None:
    """State files of earlier versions have no count, one may be damaged, and a number has to fit into a line of the ground."""
    before = Bench([unit("a"), unit("b")])
    before.see("a", BAD)
    later = Bench([unit("a"), unit("b")])
    faults = [replace(fault, id=f"ab12-{kept}") for fault in before.tracker.open_faults()]
    later.tracker.restore(faults, (), later.stamp(), count)
    later.see("b", BAD)
    assert [fault.id for fault in later.tracker.open_faults()] == [f"ab12-{kept}", f"F{following}"]


@pytest.mark.parametrize("change", [{"never_ok": True}, {"patient": True}, {"file": "/b"}, {"listed": 2}])
def test_a_fault_follows_the_evidence_that_recovery_decides_by(change: dict[str, Any]) -> None:
    """In the same words, in a new run of the container or for another file. It is not published again."""
    bench = Bench([unit("files")])
    known = Evidence(never_ok=False, file="/a", listed=1)
    bench.see("files", BAD.with_evidence(known))
    bench.later(1)
    published = len(bench.events)
    bench.see("files", BAD.with_evidence(replace(known, **change)))
    (fault,) = bench.tracker.open_faults()
    assert fault.result.evidence == replace(known, **change)
    assert len(bench.events) == published
