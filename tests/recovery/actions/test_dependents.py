"""Which dependents a restart takes along, when one of them is left alone or the engine does not answer."""

from __future__ import annotations

import pytest

from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions.restart import Restart
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine
from tests.fakes.engine_faults import Status
from tests.recovery.action_bench import Bench
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


def unanswered(monkeypatch: pytest.MonkeyPatch, fake: FakeEngine, **times: int) -> None:
    """So many requests about these containers are not answered after the target was restarted."""
    fact = Bench.fact

    def asked(bench: Bench, key: str) -> ContainerFact | None:
        if acted_on(fake, "restart") and times.get(key, 0) > 0:
            times[key] -= 1
            raise CannotTell("no response within 5 s")
        return fact(bench, key)

    monkeypatch.setattr(Bench, "fact", asked)


def test_one_request_without_an_answer_leaves_out_no_dependent(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine is often slow while it starts the container: PHM asks once more."""
    made = stack(fake, ask)
    unanswered(monkeypatch, fake, app=1, side=1)
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app", "side", "late"]
    assert words == "restarted app; restarted side, which depends on it; restarted late, which depends on it"


def test_a_container_that_the_engine_does_not_describe_is_named(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether it shares a namespace, and whether one that names the target in `after` exists, is not known."""
    made = stack(fake, ask)
    unanswered(monkeypatch, fake, side=2, late=2)
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app"]
    assert words == "restarted app" + "".join(
        f"; it is not known whether {key} must be restarted, too: no response within 5 s: check it manually"
        for key in ("late", "side")
    )


def test_dependents_are_named_if_it_is_not_known_whether_the_target_runs(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those in its namespaces, too. The engine could stop but not start them if it does not run."""
    made = stack(fake, ask)
    unanswered(monkeypatch, fake, app=2)
    words = made.run(Restart, "app", EXITED)
    assert acted_on(fake, "restart") == ["app"]
    assert words == (
        "restarted app; side, late not restarted, because it is not known whether app runs: no response within 5 s: "
        "check them manually"
    )
