"""Which dependents a restart takes along, when one of them is left alone or the engine does not answer."""

from __future__ import annotations

from phm.recovery.actions.restart import Restart
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine
from tests.fakes.engine_faults import Status
from tests.recovery.actions.test_container_actions import EXITED, acted_on, stack


def test_a_container_is_left_alone_with_what_it_depends_on(fake: FakeEngine, ask: DockerEngine) -> None:
    """It would lose its run for nothing, and needs another restart once a person restarts what it depends on."""
    made = stack(fake, ask, side={"recover": False}, late={"after": ["side"]})
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app"]
    assert words.endswith("; late depends on side and was left alone: restart it after side")


def test_a_container_follows_one_that_was_or_may_have_been_restarted(fake: FakeEngine, ask: DockerEngine) -> None:
    """By another recovery, or by an engine that has answered with an error: its namespace or its connection may be lost."""
    made = stack(fake, ask, late={"after": ["side"]})
    made.when_in_hand = lambda: fake.containers["side"]["State"].update(StartedAt="2026-01-01T00:00:01Z")
    made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "late"]
    fake.calls.clear()
    made.when_in_hand = lambda: None
    fake.fault = Status(500, "no", route=f"{fake.containers['side']['Id']}/restart")
    made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "side", "late"]
