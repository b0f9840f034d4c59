"""What a lost network hides, and what it does not."""

from __future__ import annotations

from phm.api import Level, error, stale
from phm.core.model import Evidence, Outcome
from tests.fakes.tracker_bench import BAD, OK, Bench, unit


def test_a_lost_network_hides_silence_but_not_an_ended_process() -> None:
    """That a process has ended is known from the Docker Engine; nothing on a network ends it. A lost container does hide it."""
    gone = error("process ended", brief="dead", condition="node_missing").with_evidence(Evidence(conclusive=True))
    bench = Bench([unit("container/app"), unit("network/app", "container/app"), unit("nodes/n", "network/app")])
    bench.all_healthy()
    bench.now += 1
    bench.see("network/app", BAD)
    bench.see("container/app", OK)
    bench.see("nodes/n", BAD)
    assert bench.blocked_by("nodes/n") == "network/app"
    bench.now += 1
    for _ in range(2):
        bench.see("nodes/n", gone)
        bench.see("container/app", OK)
        bench.see("network/app", BAD)
    assert bench.opened == ["network/app", "nodes/n"]
    bench.see("container/app", BAD)
    bench.see("network/app", BAD)
    bench.see("nodes/n", gone)
    assert bench.blocked_by("nodes/n") == "container/app"


def test_a_lost_network_does_not_hide_a_stopped_process() -> None:
    """The engine lists its state; no network has sent it a signal."""
    stopped = error("process stopped", brief="hung", condition="node_hung").with_evidence(
        Evidence(certain=True, conclusive=True)
    )
    bench = Bench([unit("container/app"), unit("network/app", "container/app"), unit("nodes/n", "network/app")])
    bench.all_healthy()
    bench.now += 1
    for _ in range(2):
        bench.see("network/app", BAD)
        bench.see("nodes/n", stopped)
        bench.see("container/app", OK)
        bench.see("network/app", BAD)
        bench.now += 1
    assert bench.opened == ["network/app", "nodes/n"]


def test_an_ended_process_is_published_without_a_result_of_its_network() -> None:
    """A hung network would delay the alarm, and cannot explain it; a node that is only silent waits for the network."""
    gone = error("process ended", brief="dead", condition="node_missing").with_evidence(Evidence(conclusive=True))
    bench = Bench([unit("container/app"), unit("network/app", "container/app"), unit("nodes/n", "network/app")])
    bench.all_healthy()
    bench.now += 1
    bench.see("nodes/n", BAD)
    bench.see("container/app", OK)
    assert bench.opened == []
    bench.now += 1
    bench.see("nodes/n", gone)
    bench.see("container/app", OK)
    assert bench.opened == ["nodes/n"]


def test_a_lost_network_hides_what_a_running_node_reports() -> None:
    """It is conclusive that a node repeats old data or has no input, but its camera may be on that network: one cause, one alarm."""
    frozen = error("frozen", brief="frozen", condition="data_frozen").with_evidence(Evidence(conclusive=True))
    bench = Bench([unit("container/app"), unit("network/app", "container/app"), unit("data/image", "network/app")])
    bench.all_healthy()
    bench.now += 1
    bench.see("network/app", BAD)
    bench.see("container/app", OK)
    for _ in range(3):
        bench.now += 1
        bench.see("data/image", frozen)
        bench.see("container/app", OK)
        bench.see("network/app", BAD)
    assert bench.opened == ["network/app"]
    assert bench.blocked_by("data/image") == "network/app"


def test_an_ended_process_that_is_unknown_later_is_not_reattributed_to_the_network() -> None:
    """PHM has lost the network, too, and cannot see whether the node is back: its fault stays open, as no network has ended the process."""
    gone = error("process ended", brief="dead", condition="node_missing").with_evidence(Evidence(certain=True))
    bench = Bench([unit("container/app"), unit("network/app", "container/app"), unit("nodes/n", "network/app")])
    bench.all_healthy()
    bench.now += 1
    for _ in range(2):
        bench.see("nodes/n", gone)
        bench.see("container/app", OK)
    for _ in range(2):
        bench.now += 1
        bench.see("network/app", BAD)
        bench.see("container/app", OK)
        bench.see("network/app", BAD)
        bench.see("nodes/n", stale("not seen"))
    assert (bench.level("nodes/n"), bench.blocked_by("nodes/n")) == (Level.STALE, "")
    assert (bench.opened, bench.closed) == (["nodes/n", "network/app"], [])
    bench.see("nodes/n", BAD)
    assert bench.closed == [("nodes/n", Outcome.REATTRIBUTED, "network/app")], "what the network explains"
