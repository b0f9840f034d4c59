"""An engine that takes seconds to answer: meanwhile the container may be started again, or the fault may end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Fault, Phase
from phm.recovery.base import ActionContext, Target
from phm.testing import FakeClock
from phm.transport.docker import EngineConflict, EngineMissing, EngineRefused, EngineTimeout
from tests.recovery.holds.scene import Scene, stopped
from tests.recovery.simulated_agent import Agent, Containers, Of

GRACE_S = 8.0
BOOT_S = 5.0
CALL_S = 20.0
NODES = "nodes/app"


def make_agent() -> Agent:
    units = {"container/app": Of("app"), NODES: Of("app", ("container/app",), grace_s=GRACE_S)}
    agent = Agent(units, Containers("app"), FakeClock(), verify="30s", ladders={"hung": ["restart"]})
    agent.rest(2 * GRACE_S)
    return agent


@pytest.mark.parametrize("recreated", [False, True])
def test_a_container_that_was_started_by_a_failed_call_gets_its_grace(recreated: bool) -> None:
    """The restart was done, but its answer came too late; or someone has recreated the container. Its nodes need BOOT_S. Three
    restarts followed each other, and PHM gave up on a container that started each time."""
    agent, begun = make_agent(), []

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        begun.append(agent.clock.mono())
        agent.pause(lambda: agent.clock.mono() - begun[-1] > CALL_S - 0.5)
        (agent.containers.recreate if recreated else agent.containers.start)(key)
        up_at = agent.clock.mono()
        agent.pipeline.container_started(key)
        agent.observe = lambda: (agent.clock.mono() - up_at >= BOOT_S and agent.bad.clear(), observe())[1]  # type: ignore[method-assign]
        agent.pause(lambda: agent.clock.mono() - begun[-1] > CALL_S)
        agent.engine.fails = EngineMissing("HTTP 404") if recreated else EngineTimeout("no answer within 20 s")
        context.engine.restart(key)

    observe = agent.observe
    agent.behave = behave
    agent.bad = {NODES: "hung"}
    agent.until(lambda: Phase.FAILED in agent.steps(), "the failure")
    agent.rest(60.0)
    assert len(begun) == 1
    assert not agent.pipeline.open_faults()
    agent.stop()


def test_a_fault_that_ended_while_the_engine_was_asked_is_not_acted_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """What an action needs is looked up with the engine, up to 5 s for each call: an operator recreated the container meanwhile."""
    agent, asked = make_agent(), []

    def waits_for(self: object, target: Target, fault: Fault, context: ActionContext) -> str:
        asked.append(agent.clock.mono())
        agent.pause(lambda: agent.clock.mono() - asked[0] > 6.0)
        return ""

    monkeypatch.setattr(agent.executor.catalog.get("restart"), "waits_for", waits_for)
    agent.bad = {NODES: "hung"}
    agent.until(lambda: bool(asked), "the question")
    agent.containers.recreate("app")
    agent.pipeline.container_started("app")
    agent.bad.clear()
    agent.rest(30.0)
    assert not agent.pipeline.open_faults()
    assert agent.runs == []
    agent.stop()


def test_a_call_without_an_answer_about_an_earlier_container_starts_no_new_one() -> None:
    """The engine lost PHM's restart, and the container was recreated. When the operator stops the new one, it stays stopped."""
    scene = Scene(backoff=1.0)
    agent = scene.agent

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        agent.engine.fails = EngineTimeout("no answer")
        try:
            context.engine.restart(key)
        finally:
            agent.engine.fails = None

    agent.behave = behave
    agent.bad = {"container/cam": "broken"}
    agent.until(lambda: Phase.FAILED in agent.steps("cam"), "the failure")
    scene.containers.recreate("cam")
    scene.happen(("start", ""), key="cam")
    agent.bad.clear()
    agent.rest(100.0)
    before = len(agent.runs)
    stopped(scene, "cam")
    agent.rest(30.0)
    assert ("cam", True) in scene.changes()
    assert len(agent.runs) == before
    scene.stop()


@pytest.mark.parametrize(("error", "runs"), [(EngineConflict, 2), (EngineRefused, 1)])
def test_only_a_lack_of_permission_ends_the_attempts(error: type[Exception], runs: int, tmp_path: Path) -> None:
    """An address that is in use is free again later: the container is started then."""
    containers = Containers("app")
    more: dict[str, Any] = {"actions": ("start",), "ladders": {"exited": ["start"]}, "verify": "5s"}
    agent = Agent({"container/app": Of("app")}, containers, FakeClock(), folder=tmp_path, **more)
    agent.rest(20.0)

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        if len(agent.runs) == 1:
            raise error("address already in use")
        containers.start(key)
        agent.bad.clear()

    agent.behave = behave
    containers.end("app")
    agent.bad = {"container/app": "exited"}
    agent.until(lambda: Phase.FAILED in agent.steps(), "the failure")
    agent.rest(120.0)
    assert len(agent.runs) == runs
    agent.stop()
