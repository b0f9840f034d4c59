"""Recovery while the Docker Engine does not respond: it waits, and no attempt is spent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from phm.api import Evidence, error, ok, stale
from phm.core.model import Fault, Phase
from phm.facts import ContainerFact
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from phm.transport.docker import EngineTimeout
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


TIMEOUT = EngineTimeout("the Docker Engine did not answer inspect app within 5 s")


class Unanswered(Containers):
    """While `silent`, the engine answers others, but no question about a container."""

    silent = False

    def get(self, key: str) -> ContainerFact | None:
        if self.silent:
            raise TIMEOUT
        return super().get(key)


@pytest.fixture
def unanswered() -> Iterator[tuple[Agent, Unanswered]]:
    containers = Unanswered("app")
    units = {"container/app": Of("app"), "nodes/one": Of("app", ("container/app",), grace_s=GRACE_S)}
    made = Agent(units, containers, FakeClock(), verify="5s", ladders={"node_hung": ["restart"]})
    made.rest(2 * GRACE_S)
    yield made, containers
    made.stop()
    made.clock.advance(1000)


def test_an_action_waits_while_the_engine_does_not_answer_about_its_container(
    unanswered: tuple[Agent, Unanswered],
) -> None:
    """Nothing was done, so three such attempts must not end in giving up."""
    agent, containers = unanswered
    agent.behave = lambda *_: agent.found.clear()
    containers.silent = True
    agent.found |= {"container/app": stale("no answer"), "nodes/one": HUNG}
    agent.until(agent.steps, "the refusal")
    agent.rest(30.0)
    assert agent.steps() == [Phase.REFUSED] and str(TIMEOUT) in agent.actions()[0].detail
    assert agent.executor._histories["app"].attempts == []
    containers.silent = False
    del agent.found["container/app"]
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
    assert agent.steps() == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


@pytest.mark.parametrize("changing", [False, True])
def test_an_attempt_counts_only_if_it_may_have_changed_something(
    unanswered: tuple[Agent, Unanswered], *, changing: bool
) -> None:
    """The engine falls silent during the attempt; a call to restart that it did not answer may be carried out later."""
    agent, containers = unanswered

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        containers.silent, agent.engine.fails = True, TIMEOUT
        (context.engine.restart if changing else context.engine.inspect)(key)

    agent.behave = behave
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: len(agent.steps()) == 3, "the end of the attempt, and the refusal of the next")
    agent.rest(10.0)
    assert agent.steps() == [Phase.STARTED, Phase.FAILED if changing else Phase.REFUSED, Phase.REFUSED]
    assert len(agent.executor._histories["app"].attempts) == changing
