"""An operator's approval: for one action, in the situation in which it was given, and for a short time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.model import ActionEvent, Phase
from phm.recovery.executor import NotNow
from phm.recovery.operator.approval import Approval, Situation
from phm.recovery.safety.armed_state import ArmedState
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

THEN = Situation("restart", ArmedState.ARMED, "app@1")


@pytest.mark.parametrize(
    ("now", "situation", "words"),
    [
        (59.9, THEN, ""),
        (60.0, THEN, "not possible within 60 s"),
        (1.0, replace(THEN, armed=ArmedState.DISARMED), "was armed when it was given, and is disarmed now"),
        (1.0, replace(THEN, armed=ArmedState.UNKNOWN), "neither reliably armed nor disarmed now"),
        (1.0, replace(THEN, generation="app@2"), "started or recreated since"),
        (1.0, replace(THEN, action="reconnect"), "the next step is reconnect now"),
    ],
)
def test_an_approval_is_valid_only_in_its_situation(now: float, situation: Situation, words: str) -> None:
    """Armed state, container generation and action are what the operator saw; and it expires soon."""
    void = Approval(THEN, 0.0, 60.0).void(now, situation)
    assert words in void
    assert bool(void) is bool(words)


@pytest.fixture
def agents() -> Iterator[list[Agent]]:
    made: list[Agent] = []
    yield made
    for agent in made:
        agent.stop()


def broken(agents: list[Agent], folder: Path | None = None, **recovery: object) -> Agent:
    """An agent whose container is broken and stays broken after any action."""
    made = Agent({"container/app": Of("app")}, Containers("app"), FakeClock(), folder=folder, **recovery)  # type: ignore[arg-type]
    agents.append(made)
    made.bad["container/app"] = "broken"
    return made


def fault_of(made: Agent) -> str:
    made.until(lambda: made.pipeline.open_faults(), "the fault")
    return made.pipeline.open_faults()[0].id


def expired(made: Agent) -> list[str]:
    return [event.detail for event in made.of(ActionEvent) if event.phase is Phase.EXPIRED]


def advised(agents: list[Agent], folder: Path | None = None, **recovery: object) -> tuple[Agent, str]:
    made = broken(agents, folder, mode="advise", **recovery)
    fault = fault_of(made)
    made.until(lambda: Phase.ADVISED in made.steps(), "the advice")
    return made, fault


def lock_target(made: Agent) -> None:
    """Let another recovery lock the container, so that no action can begin yet."""
    assert made.locks.acquire("app", made)


def test_an_approval_given_on_the_ground_is_void_in_flight(agents: list[Agent]) -> None:
    """It is not executed; the operator is informed, and the action is advised again."""
    made, fault = advised(agents)
    lock_target(made)
    made.executor.approve(fault)
    made.rest(1.0)
    made.armed = True
    made.until(lambda: expired(made), "the message")
    made.locks.release("app", made)
    made.rest(5.0)
    assert made.runs == []
    assert "was disarmed when it was given, and is armed now" in expired(made)[0]
    assert made.steps().count(Phase.ADVISED) == 2


def test_an_approval_expires_with_a_message(agents: list[Agent]) -> None:
    """An action that was not possible within `recovery.approval` is not done later."""
    made, fault = advised(agents, approval=20)
    lock_target(made)
    made.executor.approve(fault)
    made.rest(19.0)
    assert expired(made) == []
    made.rest(2.0)
    assert "restart app expired: it was not possible within 20 s" in expired(made)[0]
    made.locks.release("app", made)
    made.rest(5.0)
    assert made.runs == []


def test_another_generation_of_the_container_voids_an_approval(agents: list[Agent]) -> None:
    """It was started externally meanwhile: the approved action may no longer be needed."""
    made, fault = advised(agents)
    lock_target(made)
    made.executor.approve(fault)
    made.rest(1.0)
    made.containers.start("app")
    made.until(lambda: expired(made), "the message")
    assert "started or recreated since" in expired(made)[0]


def test_an_approval_expires_while_the_budget_is_used_up(agents: list[Agent]) -> None:
    """An action that is not possible within its lifetime is denied immediately, with the reason; nothing is executed
    minutes later.
    """
    made, fault = advised(agents, budget=1, same_failure=5)
    made.executor.approve(fault)
    made.until(lambda: len(made.runs) == 1 and Phase.FAILED in made.steps(), "the first attempt")
    made.until(lambda: made.steps()[-1] is Phase.ADVISED, "the second advice")
    with pytest.raises(NotNow, match=r"budget of 1 actions used up: not possible within the 60 s of an approval"):
        made.executor.approve(fault)
    made.rest(700.0)
    assert len(made.runs) == 1


def test_an_approval_is_valid_for_an_immediate_action(agents: list[Agent]) -> None:
    """In the situation in which it was given the action is done, also in flight."""
    made, fault = advised(agents, critical=("app",))
    made.armed = True
    made.rest(1.0)
    made.executor.approve(fault)
    made.until(lambda: made.runs == [("app", "container/app")], "the restart")


def test_a_restart_of_phm_ends_an_approval_with_a_message(agents: list[Agent], tmp_path: Path) -> None:
    """It does not survive, and this is reported."""
    made, fault = advised(agents, tmp_path)
    lock_target(made)
    made.executor.approve(fault)
    made.rest(2.0)
    made.stop()
    agents.clear()
    second = Agent(
        {"container/app": Of("app")}, made.containers, made.clock, folder=tmp_path, mode="advise"
    )  # the same fault is still open
    agents.append(second)
    second.bad["container/app"] = "broken"
    second.rest(5.0)
    assert second.runs == []
    assert ["PHM has been restarted or reloaded; approve it again" in words for words in expired(second)] == [True]
    assert second.steps() == [Phase.EXPIRED, Phase.ADVISED]


def test_a_requested_restart_expires_too(agents: list[Agent]) -> None:
    """Requested on the ground while another recovery was running, it is not done in flight minutes later."""
    made = Agent({"container/app": Of("app")}, Containers("app"), FakeClock())
    agents.append(made)
    made.step()
    assert made.locks.acquire("app", made)
    made.executor.restart("app", "255/190")
    made.rest(61.0)
    made.locks.release("app", made)
    made.rest(5.0)
    assert made.runs == []
    assert [event.phase for event in made.of(ActionEvent)] == [Phase.REFUSED]


def test_one_recommendation_is_approved_once(agents: list[Agent]) -> None:
    """A second ground station approves while the first restart is verified: that does not approve a second one."""
    made = broken(agents, critical=("app",), verify=5.0, backoff=0.1)
    made.armed = True
    fault = fault_of(made)
    made.until(lambda: Phase.ADVISED in made.steps(), "the advice")
    made.executor.approve(fault)
    made.until(lambda: Phase.DONE in made.steps(), "the restart")
    with pytest.raises(NotNow, match="restart of app is under way"):
        made.executor.approve(fault)
    made.rest(40.0)
    assert made.runs == [("app", "container/app")]


def test_the_end_of_an_attempt_voids_earlier_approvals(agents: list[Agent]) -> None:
    """Of two faults of a container both restarts were approved: after the first it must be decided again."""
    made = Agent(
        {"container/app": Of("app"), "health/app": Of("app")}, Containers("app"), FakeClock(), critical=("app",)
    )
    agents.append(made)
    made.armed = True
    made.bad = {"container/app": "broken", "health/app": "broken"}
    made.behave = lambda *_: None  # no new generation, which would void it, too
    made.until(lambda: made.steps().count(Phase.ADVISED) == 2, "two recommendations")
    lock_target(made)
    for fault in made.pipeline.open_faults():
        made.executor.approve(fault.id)
    made.locks.release("app", made)
    made.until(lambda: expired(made), "the message")
    made.rest(40.0)
    assert "another action on app has ended since" in expired(made)[0]
    assert len(made.runs) == 1
