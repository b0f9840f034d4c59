"""What a fault takes from the unit that failed."""

from __future__ import annotations

from dataclasses import replace

from tests.fakes.tracker_bench import BAD, Bench, unit


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
