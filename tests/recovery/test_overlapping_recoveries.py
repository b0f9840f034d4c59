"""Simultaneous recoveries of several containers: no container has two owners, and PHM's own actions raise no fault."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from phm import testing
from phm.core.model import ActionEvent, Fault, Phase
from phm.facts import CannotTell
from phm.recovery.base import ActionContext
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {name: Of(name.partition("/")[2], grace_s=2.0) for name in ("health/a", "health/b", "health/side")}
RULES: dict[str, Any] = {"verify": 30.0, "backoff": 0.1}


class Owners(Agent):
    """`a` and `b` restart `side` after themselves. `within` is the present owner of `side`, `seen` all owners."""

    def __init__(self, **recovery: Any) -> None:
        containers = Containers("a", "b", "side")
        super().__init__(UNITS, containers, testing.FakeClock(), opted_in=("a", "b", "side"), **{**RULES, **recovery})
        self.within: list[str] = []
        self.seen: list[str] = []
        self.refused: list[str] = []
        self.open = False
        self.behave = self._act

    def _act(self, key: str, context: ActionContext, fault: Fault) -> None:
        if key == "side":
            self._work_on_side(key)
            return
        self.containers.start(key)
        self.bad.pop(f"health/{key}", None)
        try:
            with context.lock_dependent("side", fault, "restart", 30.0):
                self._work_on_side(key)
        except CannotTell as error:
            self.refused.append(str(error))

    def _work_on_side(self, who: str) -> None:
        self.within.append(who)
        assert len(self.within) == 1, f"side is locked by {self.within}"
        self.seen.append(who)
        self.bad["health/side"] = "broken"  # its state while it is being restarted
        self.pause(lambda: self.open)
        self.containers.start("side")
        self.bad.pop("health/side", None)
        self.pause(lambda: True)  # results of this step are from before the end
        self.within.remove(who)


@pytest.fixture
def agents() -> Iterator[list[Owners]]:
    made: list[Owners] = []
    yield made
    for agent in made:
        agent.open = True
        agent.stop()
        agent.clock.advance(1000)


def make(agents: list[Owners], **recovery: Any) -> Owners:
    agents.append(Owners(**recovery))
    agents[-1].rest(3.0)
    return agents[-1]


def test_two_owners_of_one_dependent_restart_it_one_after_the_other(agents: list[Owners]) -> None:
    """Both break at the same time; the state of `side` meanwhile is not a separate alarm."""
    agent = make(agents)
    agent.bad |= {"health/a": "broken", "health/b": "broken"}
    agent.until(lambda: len(agent.runs) == 2, "both actions")
    agent.rest(2.0)
    assert len(agent.seen) == 1
    agent.open = True
    agent.until(lambda: agent.steps("a")[-1:] == agent.steps("b")[-1:] == [Phase.VERIFIED], "both proofs")
    assert sorted(agent.seen) == ["a", "b"]
    agent.rest(10.0)
    assert sorted(agent.opened()) == ["health/a", "health/b"]


def test_a_container_that_is_being_recovered_is_waited_for(agents: list[Owners]) -> None:
    """`side` is being restarted for its own fault when `a` breaks: `a` is restarted immediately, `side` after that."""
    agent = make(agents)
    agent.bad["health/side"] = "broken"
    agent.until(lambda: agent.seen == ["side"], "the recovery of side")
    agent.bad["health/a"] = "broken"
    agent.until(lambda: len(agent.runs) == 2, "the action on a")
    agent.rest(2.0)
    assert (agent.within, agent.seen) == (["side"], ["side"])
    agent.open = True
    agent.until(lambda: agent.steps("a")[-1:] == [Phase.VERIFIED], "the verification of a")
    assert agent.seen == ["side", "a"]


def test_a_containers_own_recovery_waits_while_another_restarts_it(agents: list[Owners]) -> None:
    """And is decided again afterwards: a fault that the other's restart has resolved needs no attempt."""
    agent = make(agents)
    agent.bad["health/side"] = "odd"  # no ladder: only reported
    agent.until(lambda: agent.opened() == ["health/side"], "the fault of side")
    agent.bad["health/a"] = "broken"
    agent.until(lambda: agent.within == ["a"], "the restart of side")
    agent.rest(5.0)
    assert agent.bad["health/side"] == "broken"
    agent.open = True
    agent.until(lambda: agent.steps("a")[-1:] == [Phase.VERIFIED], "the verification of a")
    agent.rest(10.0)
    assert agent.runs == [("a", "health/a")]
    assert agent.pipeline.open_faults() == ()


def test_a_result_from_a_dependent_restart_causes_no_action(agents: list[Owners]) -> None:
    """`side` needs a second to start after `a` has restarted it; its earlier fault waits for its grace."""
    agent = make(agents)
    agent.open = True
    agent.bad["health/side"] = "odd"
    agent.until(lambda: agent.opened() == ["health/side"], "the fault of side")

    def slow(key: str, context: ActionContext, fault: Fault) -> None:
        agent.bad.pop("health/a", None)
        with context.lock_dependent("side", fault, "restart", 30.0):
            agent.bad["health/side"] = "broken"
            agent.containers.start("side")
            agent.pause(lambda: True)

    agent.behave = slow
    agent.bad["health/a"] = "broken"
    agent.until(lambda: Phase.VERIFIED in agent.steps("a"), "the verification of a")
    agent.rest(1.0)
    del agent.bad["health/side"]
    agent.rest(5.0)
    assert agent.runs == [("a", "health/a")]


def test_a_locked_target_is_not_acted_on(agents: list[Owners]) -> None:
    """Whichever recovery has locked it; nothing counts as an attempt meanwhile."""
    agent = make(agents)
    agent.open = True
    other = object()
    assert agent.executor.locks.acquire("a", other)
    agent.bad["health/a"] = "broken"
    agent.rest(10.0)
    assert agent.steps("a") == []
    agent.executor.locks.release("a", other)
    agent.until(lambda: Phase.VERIFIED in agent.steps("a"), "the repair")
    assert len(agent.runs) == 1


def test_a_superseded_verification_is_not_a_failure_of_the_target(agents: list[Owners]) -> None:
    """`side` waits for its verification when `a` has to restart it: that attempt says nothing about `side`."""
    agent = make(agents, same_failure=1)

    def on_side(key: str, context: ActionContext, fault: Fault) -> None:
        if key == "side":
            agent.containers.start("side")
            if agent.runs.count(("side", "health/side")) == 2:
                agent.bad.clear()
            return
        agent.containers.start(key)
        agent.bad.pop(f"health/{key}")
        with context.lock_dependent("side", fault, "restart", 30.0):
            agent.containers.start("side")

    agent.behave = on_side
    agent.bad["health/side"] = "broken"
    agent.until(lambda: Phase.DONE in agent.steps("side"), "the action on side")
    agent.bad["health/a"] = "broken"
    agent.until(lambda: Phase.FAILED in agent.steps("side"), "the end of its verification")
    details = [event.detail for event in agent.of(ActionEvent) if event.phase is Phase.FAILED]
    assert details == ["side was started again by the recovery of a before restart was verified"]
    agent.until(lambda: Phase.VERIFIED in agent.steps("side"), "another attempt, which helps")
    assert Phase.ESCALATED not in agent.steps("side")


def test_an_action_may_take_longer_by_what_its_dependents_need(agents: list[Owners]) -> None:
    """Each stops slowly, and together they need longer than the action's own deadline: nothing has failed."""
    agent = make(agents)

    def slow(key: str, context: ActionContext, fault: Fault) -> None:
        agent.containers.start(key)
        for dependent in ("side", "b"):
            with context.lock_dependent(dependent, fault, "restart", 90.0):
                agent.bad[f"health/{dependent}"] = "broken"
                began = agent.clock.mono()
                agent.pause(lambda began=began: agent.clock.mono() - began > 80.0)  # type: ignore[misc]
                agent.containers.start(dependent)
                del agent.bad[f"health/{dependent}"]
        agent.bad.pop("health/a", None)

    agent.behave = slow
    agent.bad["health/a"] = "broken"
    agent.until(lambda: agent.steps("a")[-1:] in ([Phase.VERIFIED], [Phase.FAILED]), "the end of the attempt")
    assert agent.steps("a") == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    assert agent.opened() == ["health/a"]


def test_an_abandoned_action_begins_nothing_more(agents: list[Owners]) -> None:
    """It returns after its deadline: dependents are not restarted any more."""
    agent = make(agents, same_failure=1)
    late: list[str] = []

    def hang(key: str, context: ActionContext, fault: Fault) -> None:
        agent.pause(lambda: late)
        try:
            with context.lock_dependent("side", fault, "restart", 30.0):
                agent.seen.append(key)
        except CannotTell as error:
            agent.refused.append(str(error))

    agent.behave = hang
    agent.bad["health/a"] = "broken"
    agent.until(lambda: Phase.ESCALATED in agent.steps("a"), "the deadline")
    late.append("now")
    agent.until(lambda: not agent.acting, "the end of the action")
    assert (agent.seen, agent.refused) == ([], ["restart of a was abandoned meanwhile"])
