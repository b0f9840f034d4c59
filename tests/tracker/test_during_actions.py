"""What is reported while an action on a container is under way, although it does not follow from a fault that is being recovered."""

from __future__ import annotations

import pytest

from phm.api import error
from phm.core.model import ON_HOLD, Level
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

EXITED = error("exited", brief="exited", condition="exited")


@pytest.fixture
def bench() -> Bench:
    made = Bench(
        [
            unit("container/app", target="app"),
            unit("network/app", "container/app", target="app"),
            unit("nodes/n", "container/app", "network/app", target="app", grace_s=8.0),
            unit("devices/app", target="app"),
        ]
    )
    made.later(10)
    made.all_healthy()
    return made


def begin(bench: Bench, owner: str, action: str = "restart") -> None:
    bench.take(bench.tracker.begin_action("app", owner, action, bench.stamp(), 300.0, verifying=True))
    bench.take(bench.tracker.container_started("app", bench.stamp()))
    bench.later(1.0)


@pytest.mark.parametrize(
    ("name", "condition"),
    [
        ("devices/app", "device_missing"),
        ("network/app", "network_missing"),
        ("network/app", "sidecar_disconnected"),
    ],
)
@pytest.mark.parametrize("owner", ["nodes/n", "container/app"])
def test_what_comes_from_outside_of_the_container_does_not_follow_from_an_action(
    bench: Bench, owner: str, name: str, condition: str
) -> None:
    """No action unplugs a device, removes a network or takes PHM off one, and its verification may last a minute."""
    bench.see(owner, BAD)
    bench.see("container/app", BAD if owner == "container/app" else OK)
    bench.see("network/app", OK)
    bench.see("nodes/n", BAD)
    assert bench.opened == [owner]
    begin(bench, owner)
    bench.see("container/app", OK)
    for _ in range(2):
        bench.later(0.5)
        bench.see(name, error("gone", brief="gone", condition=condition))
        bench.see("container/app", OK)
    assert bench.opened == [owner, name]
    bench.see("nodes/n", BAD)
    assert bench.opened == [owner, name], "what the action causes still is one"


def test_a_condition_of_the_fault_itself_does_not_change_during_its_action(bench: Bench) -> None:
    """The action was chosen for the one before."""
    bench.see("network/app", BAD)
    bench.see("container/app", OK)
    begin(bench, "network/app", "reconnect")
    bench.see("network/app", error("gone", brief="gone", condition="network_missing"))
    assert [fault.result.condition for fault in bench.tracker.open_faults()] == ["broken"]


def test_a_container_that_is_restarted_on_request_is_not_reported_as_ok(bench: Bench) -> None:
    """There is no fault that would be shown, and it may be down for as long as its stop timeout."""
    begin(bench, "container/app")
    bench.see("container/app", EXITED)
    state = bench.tracker.state("container/app")
    assert (state.level, bench.opened) == (Level.STALE, [])
    assert state.result.summary == "app is being restarted on request: exited"
    assert state.result.condition != ON_HOLD and not state.result.brief
    bench.see("container/app", OK)
    assert bench.level("container/app") is Level.OK


def test_a_requested_restart_that_fails_is_a_fault(bench: Bench) -> None:
    """As soon as it is over."""
    begin(bench, "container/app")
    bench.see("container/app", EXITED)
    bench.take(bench.tracker.end_action("app", bench.stamp(), worked=False))
    bench.later(0.5)
    bench.see("container/app", EXITED)
    assert bench.opened == ["container/app"]
