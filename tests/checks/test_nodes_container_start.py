"""Slot 6: nodes after a restart of their container."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from phm import api
from phm_checks._graph_evidence import TWICE_S
from phm_checks._liveness import LOST_S
from phm_checks._process_table import BLIND_S, QUIET_S, SOON_S
from tests.fakes.nodes_bench import (
    GRACE_S,
    MAIN,
    NAME,
    ONE,
    TWO,
    Bench,
    active_topic,
    live_beacon,
    pair,
    rated,
)


def test_observations_from_before_a_container_restart_do_not_count() -> None:
    """After it the node must start again; nothing is reported until grace is over, then that it never started."""
    bench = Bench()
    bench.after(1.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(GRACE_S - 1.0).level is api.Level.STALE
    assert bench.after(2.0).brief == "node_1 never started"


def test_a_node_that_died_in_a_later_generation_is_dead() -> None:
    """It was listed throughout the container restart, and was alive afterwards, too."""
    bench = Bench()
    bench.after(1.0)
    bench.restart_container(MAIN, api.ProcessFact(81, 1, "S", 0.0, ONE.command))
    bench.after(QUIET_S)
    bench.ros.change(nodes={NAME: 2})
    bench.after(1.0)
    bench.ros.change(nodes={NAME: 1})
    bench.after(TWICE_S)
    bench.processes(MAIN)
    bench.ros.change(nodes={})
    assert bench.after(1.0).brief == "node_1 dead"


def test_a_stale_graph_after_a_restart_raises_no_alarm() -> None:
    """The old name stays listed, then disappears before the new one comes: its process runs, so it is starting."""
    bench = rated()
    bench.after(3.0)
    levels = []

    def restart(passed: float) -> None:
        if passed == 0.25:
            bench.restart_container(MAIN, api.ProcessFact(81, 1, "R", 0.0, ONE.command))
        bench.ros.change(topics=active_topic(passed), nodes={NAME: 1} if passed < 1.5 or passed > 4.0 else {})
        if passed > 4.0:
            bench.ros.change(topics=active_topic())
        levels.append(bench.result().level)

    assert bench.after(6.0, restart).level is api.Level.OK
    assert api.Level.ERROR not in levels


def test_a_stale_graph_after_a_restart_hides_no_dead_node() -> None:
    """With a lease of 20 s the name stays, but the process that was always found is missing."""
    bench = rated()
    bench.after(3.0)
    bench.restart_container(MAIN)
    result = bench.after(GRACE_S + 3.0, lambda passed: bench.ros.change(topics=active_topic(passed)))
    assert (result.level, result.condition) == (api.Level.ERROR, "node_missing")
    assert "no process in its container matches it" in result.summary


def test_a_node_restarted_beside_its_siblings_is_not_dead() -> None:
    """It has a new process: the container keeps running, the old name stays until its lease expires."""
    bench = rated()
    bench.after(3.0)
    levels = []

    def relaunched(passed: float) -> None:
        bench.processes(MAIN, api.ProcessFact(95, 1, "S", 0.0, ONE.command))
        bench.ros.change(
            topics=active_topic(passed if passed < 2.0 else 0.0), nodes={} if 0.5 < passed < 2.0 else {NAME: 1}
        )
        levels.append(bench.result().level)

    result = bench.after(5.0, relaunched)
    assert (result.level, result.values["process"]) == (api.Level.OK, "95 S")
    assert api.Level.ERROR not in levels


def test_a_missing_process_with_two_candidates_does_not_prove_a_dead_node() -> None:
    """One of them may be the node; which one is unknown, so there is no such evidence."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN, *(api.ProcessFact(pid, 1, "S", 0.0, ONE.command) for pid in (91, 92)))
    result = bench.after(3.0)
    assert (result.level, result.values["process"]) == (api.Level.OK, "71 ended")


def test_a_reported_node_is_checked_until_it_is_ok() -> None:
    """A stopped node without beacon and topic: nothing in the graph shows that it was resumed."""
    bench = Bench()
    bench.after(20.0)
    bench.processes(MAIN, api.ProcessFact(71, 1, "T", 5.0, ONE.command))
    bench.after(BLIND_S + 0.25)
    bench.processes(MAIN, ONE)
    assert bench.after(SOON_S).level is api.Level.OK


def test_a_node_that_returns_as_an_unknown_process_is_alive() -> None:
    """Started manually with other arguments: it is in the graph again, and its old process no longer matters."""
    bench = Bench()
    bench.after(3.0)
    bench.processes(MAIN)
    assert bench.after(3.0).brief == "node_1 dead"
    bench.ros.change(nodes={})
    bench.after(1.0)
    bench.processes(MAIN, api.ProcessFact(99, 1, "S", 0.0, "gdb /opt/thing"))
    bench.ros.change(nodes={NAME: 1})
    assert bench.after(1.0).level is api.Level.OK


@pytest.mark.parametrize(
    ("status", "condition"), [("exited", "node_missing"), ("paused", "node_hung"), ("restarting", "node_missing")]
)
def test_the_state_of_a_container_that_does_not_run_is_in_the_text(status: str, condition: str) -> None:
    """The node depends on its container, which raises the alarm; the node's text has the evidence nevertheless."""
    bench = rated()
    bench.after(3.0)
    bench.docker.change("ros_app", status=status)
    bench.ros.change(topics=active_topic(0.5))
    bench.clock.advance(0.25)
    result = bench.result()
    assert (result.condition, f"its container is {status}" in result.summary) == (condition, True)
    bench.docker.change("ros_app", status="running", started_at="later")
    bench.ros.change(topics=active_topic())
    assert bench.after(1.25).level is api.Level.OK


def test_a_launcher_seen_before_its_nodes_is_not_one_of_them() -> None:
    """At first only the launcher has the node's name; then the node starts and is killed, and the launcher remains."""
    main = replace(MAIN, command='python -m sitl.application.app --graph [{"name": "node_1"}]')
    bench = rated()
    bench.processes(main)
    bench.after(0.5)
    bench.processes(main, replace(ONE, parent=main.pid))
    assert bench.after(12.0).values["process"] == "71 S"
    bench.processes(main)
    bench.ros.change(topics=active_topic(0.25))
    bench.clock.advance(0.25)
    assert bench.result().brief == "node_1 dead"


# ---------------------------------------------------------------- missing after a start


def started_process(bench: Bench, process: api.ProcessFact, ago_s: float) -> api.ProcessFact:
    """The process as `ps` shows it, started `ago_s` before now: its age in whole seconds."""
    return replace(process, age_s=float(int(ago_s)))


def restarted(
    bench: Bench, late_s: float = 0.0, sibling_s: float = 0.0, command: str = TWO.command, watched_s: float = 10.0
) -> Callable[[float], None]:
    """Let both nodes run for `watched_s`, node_1 started `late_s` after node_2; restart the container, with node_2 after
    `sibling_s`.

    Returns a function that updates the world to each moment after the restart.
    """
    for passed in range(int(watched_s * 4)):
        bench.processes(
            MAIN, started_process(bench, ONE, 100 - late_s + passed / 4), started_process(bench, TWO, 100 + passed / 4)
        )
        bench.result()
        bench.clock.advance(0.25)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})

    def later(passed: float) -> None:
        came = api.ProcessFact(92, 1, "S", 0.0, command)
        bench.processes(MAIN, *([started_process(bench, came, passed - sibling_s)] if passed >= sibling_s else []))

    return later


def first_bad(bench: Bench, each: Callable[[float], None], within_s: float = 30.0) -> tuple[float, api.Result]:
    """When node_1 is reported as bad, in seconds after the restart, and its result."""
    for number in range(1, int(within_s * 4)):
        bench.clock.advance(0.25)
        each(number * 0.25)
        result = bench.result()
        if result.level.bad:
            return number * 0.25, result
    raise AssertionError("node_1 was never reported")


def test_a_node_missing_from_a_start_is_reported_before_grace_ends() -> None:
    """Its sibling started as usual and it did not, long after its usual time: a conclusive result."""
    bench = pair()
    after_s, result = first_bad(bench, restarted(bench))
    assert 2.0 <= after_s <= 3.5
    assert (result.condition, result.brief, result.evidence.certain) == ("node_missing", "node_1 never started", True)
    assert "it was not started with its container in ros_app: no process" in result.summary


def test_a_node_that_usually_starts_late_gets_its_time() -> None:
    """Three times as long as before, plus a second."""
    bench = pair()
    after_s, _ = first_bad(bench, restarted(bench, late_s=1.5))
    assert 5.5 <= after_s <= 7.0


def test_the_time_counts_from_the_first_node() -> None:
    """What a container does before it starts any node may take any time."""
    bench = pair()
    after_s, _ = first_bad(bench, restarted(bench, sibling_s=3.0))
    assert 5.0 <= after_s <= 6.5


def test_a_slow_start_gives_all_nodes_more_time() -> None:
    """The other nodes show the load: one starts 2 s after the first, so the third has 4 s, less half a second
    between two checks."""
    names = ("agent_1/node_1", "agent_1/node_2", "agent_1/node_3")
    three = api.ProcessFact(73, 1, "S", 5.0, ONE.command.replace("node_1", "node_3"))
    bench = Bench(nodes=[{"name": name} for name in names])
    bench.processes(MAIN, ONE, TWO, three)
    bench.after(5.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})

    def later(passed: float) -> None:
        third = [replace(three, pid=93)] if passed >= 2.0 else []
        bench.processes(MAIN, replace(TWO, pid=92), *third)

    after_s, _ = first_bad(bench, later)
    assert 3.5 <= after_s <= 5.5


@pytest.mark.parametrize("why", ["the sibling is missing, too", "other commands start other nodes", "nothing is known"])
def test_an_unusual_start_has_its_full_grace(why: str) -> None:
    """It may be a slow machine, a new version, or a node that never existed."""
    bench = pair()
    if why == "nothing is known":
        bench.processes(MAIN)
        bench.ros.change(nodes={})
        bench.result()
        later = restarted(bench, late_s=90.0, watched_s=LOST_S - 2.0)  # not yet reported when the container restarts
    elif why == "the sibling is missing, too":
        later = restarted(bench, sibling_s=99.0)
    else:
        later = restarted(bench, command=f"{TWO.command} --other")
    after_s, result = first_bad(bench, later)
    assert after_s >= GRACE_S
    assert not result.evidence.certain


def test_the_only_node_of_a_container_has_its_full_grace() -> None:
    """No other node shows how fast this start is."""
    bench = Bench()
    bench.after(3.0)
    bench.restart_container(MAIN)
    bench.ros.change(nodes={})
    after_s, _ = first_bad(bench, lambda _: None)
    assert after_s >= GRACE_S


def test_a_node_of_the_previous_generation_that_still_sends_was_not_started_in_this_one() -> None:
    """A container replaces another that still runs: its beacon and its topic are from the old one."""
    bench = rated(nodes=[{"name": "agent_1/node_1"}, {"name": "agent_1/node_2"}])
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1}, beacons=live_beacon())
    bench.processes(MAIN, ONE, TWO)
    later = restarted(bench)
    bench.ros.change(nodes={NAME: 1, "/agent_1/node_2": 1})

    def overlapping(passed: float) -> None:
        later(passed)
        silent_s = max(0.0, passed - 0.5)
        bench.ros.change(topics=active_topic(silent_s), beacons=live_beacon(0.1 + silent_s))

    _, result = first_bad(bench, overlapping)
    assert result.brief == "node_1 never started"
