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
def test_who_is_missing_in_a_container_that_is_ending_is_not_dead(left: tuple[api.ProcessFact, ...]) -> None:
    """Its first process was killed, the others go one by one, and the engine says that it runs for a second yet."""
    bench = Contained()
    bench.processes(*left)
    bench.ros.change(nodes={})
    result = bench.after(2.0)
    assert (result.level, result.condition) == (api.Level.STALE, "")
    assert "its container is stopping: its first process 70 has ended" in result.summary
    bench.docker.change("ros_app", status="exited")
    assert "its container is exited" in bench.after(2.0).summary


def test_a_dead_node_beside_the_first_process_is_dead() -> None:
    """The container does not end: one look is enough, as ever."""
    bench = Contained()
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"


def test_a_new_life_ends_the_ending() -> None:
    """The engine has restarted it: its new first process is another one."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).level is api.Level.STALE
    bench.docker.change("ros_app", pid=170)
    bench.restart_container(replace(MAIN, pid=170), replace(ONE, pid=171))
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(1.0).level is api.Level.OK


def test_an_engine_that_never_notices_the_end_hides_no_dead_node() -> None:
    """A container that is said to run without its first process for longer than any end takes: its nodes are dead."""
    bench = Contained()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(ENDING_S - 1.0).level is api.Level.STALE
    assert bench.after(QUIET_S).condition == "node_missing"


def test_lists_that_never_show_the_first_process_prove_no_end() -> None:
    """Where the engine's list has other numbers than its state, a missing process is a dead node."""
    bench = Bench()
    bench.result()
    bench.processes()
    bench.ros.change(nodes={})
    assert bench.after(1.0).condition == "node_missing"
