"""What was certain before an action began does not follow from it, if the action leaves the container running."""

from __future__ import annotations

import pytest

from phm.api import Result, error
from phm.core.model import Evidence, Outcome
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

OFF = error("off network", brief="off", condition="disconnected").with_evidence(Evidence(conclusive=True))


def gone(observed: float) -> Result:
    """The engine listed the processes at `observed`, without that of the node."""
    seen = Evidence(certain=True, conclusive=True, observed=observed)
    return error("process ended", brief="dead", condition="node_missing").with_evidence(seen)


class Lost(Bench):
    """The network of a container is lost, at `died`; 20 ms later an action on the container begins."""

    def __init__(self, action: str = "reconnect") -> None:
        super().__init__(
            [
                unit("container/app", target="app"),
                unit("network/app", "container/app", target="app"),
                unit("nodes/a", "container/app", "network/app", target="app", grace_s=5.0),
            ]
        )
        self.later(10)
        self.all_healthy()
        self.now += 1
        self.died = self.now
        for name, result in (("network/app", OFF), ("container/app", OK), ("network/app", OFF)):
            self.see(name, result)
        self.now += 0.02
        self.begin(action)
        self.now += 0.2

    def begin(self, action: str) -> None:
        stays = action in ("reconnect", "join_network")
        self.take(
            self.tracker.begin_action(
                "app", "network/app", action, self.stamp(), 60.0, verifying=True, leaves_running=stays
            )
        )

    def look(self, node: Result, network: Result = OFF, times: int = 4) -> None:
        for _ in range(times):
            self.see("nodes/a", node)
            self.see("container/app", OK)
            self.see("network/app", network)
            self.now += 0.25

    def end(self, *, worked: bool = True) -> None:
        self.take(self.tracker.end_action("app", self.stamp(), worked=worked))


def test_a_process_that_ended_before_a_reconnection_is_a_separate_fault() -> None:
    """In a campaign `reconnect` began 20 ms after the alarm, and hid the node that had died with the network for as long."""
    bench = Lost()
    bench.look(gone(bench.died))
    assert bench.opened == ["network/app", "nodes/a"]


def test_newer_lists_of_the_same_do_not_hide_it() -> None:
    """The processes are listed twice a second."""
    bench = Lost()
    bench.see("nodes/a", gone(bench.died))
    bench.now += 0.1
    bench.look(gone(bench.now))
    assert bench.opened == ["network/app", "nodes/a"]


@pytest.mark.parametrize("action", ["restart", "start"])
def test_other_actions_hide_it(action: str) -> None:
    """They replace the process: what ended it no longer matters."""
    bench = Lost(action)
    bench.look(gone(bench.died))
    assert bench.opened == ["network/app"] and bench.blocked_by("nodes/a") == "network/app"


@pytest.mark.parametrize(
    ("action", "opened"), [("relaunch", ["nodes/b"]), ("restore_file", ["nodes/b"]), ("restart", [])]
)
def test_a_relaunch_does_not_explain_the_end_of_another_node(action: str, opened: list[str]) -> None:
    """It ends no process. A topic of the node that it starts again, and what is not certain, still follows from it."""
    bench = Bench(
        [
            unit("container/app", target="app"),
            *(unit(f"nodes/{name}", "container/app", target="app", node=f"/{name}") for name in "abc"),
            unit("rates/a", "nodes/a", target="app", node="/a"),
        ]
    )
    bench.later(10)
    bench.all_healthy()
    for name, result in (("nodes/a", gone(bench.now)), ("container/app", OK), ("nodes/a", gone(bench.now))):
        bench.see(name, result)
    bench.take(bench.tracker.begin_action("app", "nodes/a", action, bench.stamp(), 60.0, verifying=True))
    for _ in range(2):
        bench.now += 0.3
        for name, result in (
            ("nodes/b", gone(bench.now)),
            ("nodes/c", BAD),
            ("rates/a", gone(bench.now)),
            ("container/app", OK),
        ):
            bench.see(name, result)
    assert bench.opened == ["nodes/a", *opened]


def test_what_was_first_observed_during_the_action_may_follow_from_it() -> None:
    """`reconnect` may restart the container."""
    bench = Lost()
    bench.look(gone(bench.now))
    bench.look(gone(float("inf")))
    bench.look(BAD)
    assert bench.opened == ["network/app"] and bench.blocked_by("nodes/a") == "network/app"


def test_an_earlier_list_does_not_count_once_the_container_is_stopped() -> None:
    """`reconnect` restarts the container before the next run of the check."""
    bench = Lost()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 10.0))
    bench.look(gone(bench.died))
    assert bench.opened == ["network/app"] and bench.blocked_by("nodes/a") == "network/app"


def test_more_time_for_the_action_does_not_begin_it_again() -> None:
    """What it has broken by then was not broken before it."""
    bench = Lost()
    broken = bench.now
    bench.now += 1.0
    bench.begin("reconnect")
    bench.look(gone(broken))
    assert bench.opened == ["network/app"]


def test_the_restart_in_a_reconnection_is_credited_with_the_node() -> None:
    """As with a fault that was open when the action began."""
    bench = Lost()
    bench.look(gone(bench.died))
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.now += 1.0
    bench.look(OK, OK)
    bench.end()
    assert sorted(bench.closed) == [
        ("network/app", Outcome.RESOLVED, "reconnect"),
        ("nodes/a", Outcome.RESOLVED, "reconnect"),
    ]


def test_a_node_that_is_still_missing_after_the_reconnection_is_not_credited_to_it() -> None:
    """Whatever ends it later is something else."""
    bench = Lost()
    bench.look(gone(bench.died))
    bench.see("network/app", OK)
    bench.end()
    bench.now += 6.0
    bench.look(gone(bench.now), OK)
    bench.look(OK, OK)
    assert bench.closed == [
        ("network/app", Outcome.RESOLVED, "reconnect"),
        ("nodes/a", Outcome.RESOLVED, "itself"),
    ]


def test_an_action_that_was_not_needed_is_not_credited_with_the_node() -> None:
    """Someone else had connected the container."""
    bench = Lost()
    bench.take(bench.tracker.action_not_needed("app"))
    bench.look(gone(bench.died))
    bench.look(OK, OK)
    bench.end()
    assert [by for _, _, by in bench.closed] == ["itself", "itself"]


def test_a_process_that_is_stopped_does_not_follow_from_a_reconnection() -> None:
    """It was found 0.3 s after that began. `reconnect` sends no such signal; while the container is being stopped, it does not count."""
    seen = Evidence(certain=True, conclusive=True)
    stopped = error("process stopped", brief="hung", condition="node_hung").with_evidence(seen)
    bench = Lost()
    bench.look(stopped)
    assert bench.opened == ["network/app", "nodes/a"]
    bench = Lost()
    bench.take(bench.tracker.expect_stop("app", bench.stamp(), 10.0))
    bench.look(stopped)
    assert bench.opened == ["network/app"]


def test_joining_a_network_is_not_credited_with_the_node() -> None:
    """It connects PHM itself, and ends nothing that is wrong with the container."""
    bench = Lost("join_network")
    bench.look(gone(bench.died))
    bench.look(OK, OK)
    bench.end()
    assert ("nodes/a", Outcome.RESOLVED, "itself") in bench.closed
