"""Slot 6: how often the check asks the Docker Engine for processes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from phm import api, testing
from phm_checks._process_table import BLIND_S, OLD_S, QUIET_S
from phm_checks.nodes import Nodes
from tests.fakes.nodes_bench import (
    GRACE_S,
    MAIN,
    NAME,
    Bench,
    active_topic,
    live_beacon,
    rated,
)


@pytest.mark.parametrize(("made", "period_s"), [(rated, QUIET_S), (Bench, BLIND_S)])
def test_while_all_nodes_are_ok_the_engine_is_rarely_polled(made: Callable[[], Bench], period_s: float) -> None:
    """With a topic or a beacon as a fast indicator, the process list is requested only every QUIET_S."""
    bench = made()
    bench.after(20.0)
    before = bench.docker.listings
    bench.after(60.0)
    assert bench.docker.listings - before == 60 // period_s


def test_a_lasting_doubt_is_polled_less_and_less() -> None:
    """A topic that is silent for an hour must not cost one process list per second."""
    bench = rated()
    bench.after(3.0)
    before = bench.docker.listings
    bench.after(5.0, lambda passed: bench.ros.change(topics=active_topic(passed)))
    assert 6 <= bench.docker.listings - before <= 9
    bench.after(120.0, lambda passed: bench.ros.change(topics=active_topic(5.0 + passed)))
    before = bench.docker.listings
    bench.after(100.0, lambda passed: bench.ros.change(topics=active_topic(125.0 + passed)))
    assert bench.docker.listings - before == 100 // QUIET_S


def test_a_jittering_topic_does_not_cost_a_process_list_each_time() -> None:
    """It is late, recovers and is late again: one long doubt."""
    bench = rated()
    bench.after(120.0, lambda passed: bench.ros.change(topics=active_topic(0.5 if passed % 1.0 else 0.0)))
    before = bench.docker.listings
    bench.after(100.0, lambda passed: bench.ros.change(topics=active_topic(0.5 if passed % 1.0 else 0.0)))
    assert bench.docker.listings - before <= 100 // QUIET_S + 1


def test_a_lasting_doubt_hides_no_new_one() -> None:
    """The topic has been silent for minutes for another reason; then the beacon is late: polled immediately."""
    bench = rated()
    bench.ros.change(beacons=live_beacon())
    bench.after(300.0, lambda passed: bench.ros.change(topics=active_topic(passed)))
    bench.processes(MAIN)
    bench.ros.change(beacons=live_beacon(0.5))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_a_stale_name_beside_the_new_one_is_not_a_lasting_doubt() -> None:
    """It stays for a lease of 20 s; a node that dies in that time is detected as fast as usual."""
    bench = rated()
    bench.ros.change(nodes={})
    bench.after(GRACE_S)
    bench.ros.change(nodes={NAME: 2})
    assert bench.after(12.0).level is api.Level.OK
    bench.processes(MAIN)
    bench.ros.change(topics=active_topic(0.25))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


def test_a_hung_engine_is_asked_once_per_run() -> None:
    """Each request may take its full deadline, and the check has a deadline, too."""
    keys = ("one", "two", "three")
    settings = testing.settings(
        containers=[{"name": key} for key in keys],
        ros={"nodes": [{"name": f"/{key}", "container": key} for key in keys]},
    )
    (check,) = Nodes.build(settings)
    clock, asked = testing.FakeClock(), list[str]()

    class Hanging(testing.FakeDocker):
        def container(self, name: str, young_s: float = 0.0) -> api.ContainerFact | None:
            asked.append(name)
            clock.advance(5.0)
            raise api.CannotTell("the Docker Engine did not answer within 5.0 s")

    world = testing.world(clock=clock, docker=Hanging(), ros=testing.FakeRos(nodes={f"/{key}": 1 for key in keys}))
    for number in range(1, 4):
        results = check.run(world)
        assert len(asked) == number
        assert not isinstance(results, api.Result)
        assert {result.level for result in results.values()} == {api.Level.OK}


def test_an_outdated_process_list_proves_nothing() -> None:
    """If the check is delayed, earlier observations do not count."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    bench.after(BLIND_S)
    bench.docker.fail()
    bench.clock.advance(OLD_S + 1)
    assert bench.result().level is api.Level.OK
