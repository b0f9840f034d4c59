"""Differences between the expected and the read state of a container, each as the event that was lost."""

from __future__ import annotations

import pytest

from phm.probes.docker_reconcile import ExpectedState, after, differences

RUNNING = ExpectedState("a", "running", "t1", "healthy", 0, frozenset({("swarm", "n1")}))


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (RUNNING, []),
        (ExpectedState(), [("container", "destroy", "")]),
        (ExpectedState("b", "running", "t2", "healthy", 0, RUNNING.networks), [("container", "create", "")]),
        (ExpectedState("a", "running", "t2", "healthy", 0, RUNNING.networks), [("container", "restart", "")]),
        (ExpectedState("a", "paused", "t1", "healthy", 0, RUNNING.networks), [("container", "pause", "")]),
        (
            ExpectedState("a", "running", "t1", "unhealthy", 0, RUNNING.networks),
            [("container", "health_status", "unhealthy")],
        ),
        (
            ExpectedState("a", "running", "t1", "healthy", 0, frozenset({("swarm", "n2")})),
            [("network", "disconnect", "swarm"), ("network", "connect", "swarm")],
        ),
    ],
)
def test_each_difference_has_its_event(now: ExpectedState, expected: list[tuple[str, str, str]]) -> None:
    """A container or network that was recreated under the same name is another one: ids are compared."""
    assert differences(RUNNING, now) == expected


def test_values_that_an_event_does_not_have_are_not_different() -> None:
    """After a start event, health and start time are unknown until they are read."""
    started = after(ExpectedState("a", "exited", "t1", "none", 1, RUNNING.networks), "start", "", "a")
    assert differences(started, RUNNING) == []
    assert differences(after(RUNNING, "die", "", "a"), ExpectedState("a", "exited", "t1", "none", 137)) == []
    assert (
        differences(after(RUNNING, "disconnect", "swarm", "n1"), ExpectedState("a", "running", "t1", "healthy")) == []
    )


def test_a_death_after_a_published_start_is_still_found() -> None:
    """Losing the last of several events is a loss, too."""
    started = after(ExpectedState("a", "exited", "t1", "none", 1), "start", "", "a")
    dead = ExpectedState("a", "exited", "t2", "none", 2)
    assert differences(started, dead) == [("container", "die", "exit code 2")]
