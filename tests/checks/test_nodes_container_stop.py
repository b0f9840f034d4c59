"""Slot 6: nodes of a container that is stopping."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm import api
from phm_checks._process_table import ENDING_S, QUIET_S
from tests.fakes.nodes_bench import (
    MAIN,
    NAME,
    ONE,
    TWO,
    Bench,
    Contained,
)


@pytest.mark.parametrize("left", [(), (TWO,)])
def test_a_node_missing_from_a_stopping_container_is_not_dead(left: tuple[api.ProcessFact, ...]) -> None:
    """Its first process was killed, the others terminate one by one, and the engine still reports it as running."""
    bench = Contained()
    bench.processes(*left)
    bench.ros.change(nodes={})
    result = bench.after(2.0)
    assert (result.level, result.condition) == (api.Level.STALE, "")
    assert "its container is stopping: its first process 70 has ended" in result.summary
    bench.docker.change("ros_app", status="exited")
    assert "its container is exited" in bench.after(2.0).summary


def test_a_dead_node_beside_the_first_process_is_dead() -> None:
    """The container is not stopping: one check is enough, as usual."""
    bench = Contained()
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"


def test_a_certain_result_says_when_the_processes_were_listed() -> None:
    """The tracker does not use it for a run of the container that has begun since."""
    bench = Contained()
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    bench.after(1.0)
    listed = bench.result().evidence.observed
    bench.clock.advance(0.1)
    evidence = bench.result().evidence
    assert evidence.certain
    assert listed == evidence.observed < bench.clock.mono()


def test_a_restart_ends_the_stop() -> None:
    """The engine has restarted the container: its first process is new."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).level is api.Level.STALE
    bench.docker.change("ros_app", pid=170)
    bench.restart_container(replace(MAIN, pid=170), replace(ONE, pid=171))
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(1.0).level is api.Level.OK


def test_an_engine_that_never_reports_the_stop_hides_no_dead_node() -> None:
    """A container without its first process is reported as running for longer than any stop takes: its nodes are dead."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(ENDING_S - 1.0).level is api.Level.STALE
    assert bench.after(QUIET_S).condition == "node_missing"


def test_lists_that_never_had_the_first_process_prove_no_stop() -> None:
    """If the engine's process list uses other pids than its state, a missing process is a dead node."""
    bench = Bench()
    bench.result()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"
