"""Recovery while the Docker Engine does not respond: it waits, and no attempt is spent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from phm.api import Evidence, error, ok
from phm.core.model import Phase
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

DOWN = error("no answer", brief="Docker not responding", condition="engine_down")
REFUSED = error("denied", brief="Docker denies access", condition="engine_refused")
GONE = error("exited", brief="exited", condition="exited", target="app")
GRACE_S = 8.0
HUNG = error("hung", brief="hung", condition="node_hung", target="app")


@pytest.fixture
def agent() -> Iterator[Agent]:
    found = Agent(
        {"engine": Of(""), "container/app": Of("app"), "nodes/one": Of("app", grace_s=GRACE_S)},
        Containers("app"),
        FakeClock(),
        verify="5s",
        ladders={"exited": ["restart"], "node_hung": ["restart"]},
    )
    found.behave = lambda *_: found.found.pop("nodes/one", None)
    found.rest(2 * GRACE_S)
    yield found
    found.stop()


def test_an_action_waits_until_the_engine_responds(agent: Agent) -> None:
    """Three attempts that cannot succeed would end in giving up, and the container would stay down for good."""
    agent.found |= {"engine": DOWN, "nodes/one": HUNG}
    agent.until(agent.steps, "the refusal")
    agent.rest(120.0)
    assert agent.steps() == [Phase.REFUSED]
    assert agent.runs == []
    del agent.found["engine"]
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
    assert agent.steps() == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_a_run_after_the_grace_must_confirm_the_fault_once_the_engine_responds(agent: Agent) -> None:
    """Meanwhile the container may have been restarted, and the last run may have begun before that."""
    agent.found |= {"engine": DOWN, "nodes/one": HUNG}
    agent.until(agent.steps, "the refusal")
    del agent.found["engine"]
    back = agent.clock.mono()
    agent.until(lambda: Phase.STARTED in agent.steps(), "the restart")
    started = next(event for event in agent.actions() if event.phase is Phase.STARTED)
    assert started.at.mono - back >= GRACE_S


def test_an_action_waits_while_only_the_container_is_not_described(agent: Agent) -> None:
    """The engine answers others, but not about it: its cgroup shows that it is still down, and attempts would fail."""
    seen = replace(GONE, evidence=Evidence(certain=True, conclusive=True))
    agent.behave = lambda *_: agent.found.update({"container/app": ok("runs")})
    agent.found["container/app"] = seen
    agent.until(agent.steps, "the refusal")
    agent.rest(120.0)
    assert agent.steps() == [Phase.REFUSED]
    agent.found["container/app"] = GONE
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
    assert agent.steps() == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_the_engine_is_checked_each_second_while_an_action_waits_for_it(agent: Agent) -> None:
    """It may have been suspended: it answers again without an event, and its check has a period of 5 s."""
    checked: list[tuple[str, ...]] = []
    agent.pipeline.attach(lambda units, reason: checked.append(tuple(units)) if reason == "verify" else None)
    agent.found |= {"engine": DOWN, "nodes/one": HUNG}
    agent.until(agent.steps, "the refusal")
    checked.clear()
    agent.rest(10.0)
    assert 5 <= checked.count(("engine", "container/app")) <= 12


def test_an_engine_that_refuses_a_question_may_permit_an_action(agent: Agent) -> None:
    """A proxy may forbid one call and allow the other."""
    agent.found |= {"engine": REFUSED, "nodes/one": HUNG}
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
