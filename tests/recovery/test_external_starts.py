"""A container was started or recreated externally: counts are reset, holds end, the budget remains."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.model import ActionEvent, Fault, Phase
from phm.recovery.base import ActionContext
from phm.recovery.ownership import SETTLED_S
from phm.recovery.worker import GENERATION_S
from phm.transport.docker import EngineError, EngineNotConnected, EngineTimeout, EngineUnreachable
from tests.recovery.simulated_agent import Agent, Containers, Of

LATE = EngineTimeout("the engine did not answer within 20 s")
BROKEN = EngineUnreachable("the connection to the engine broke")
ABSENT = EngineNotConnected("no Docker Engine listens")
UNITS = {"health/app": Of("app", grace_s=2.0)}
RULES: dict[str, Any] = {"same_failure": 2, "verify": 5.0, "backoff": 0.1, "budget": 50}


class Yard:
    """Lives of PHM around one container, with one clock and one directory."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.clock, self.containers = folder, testing.FakeClock(), Containers("app")
        self.agents: list[Agent] = []

    def phm(self, units: Mapping[str, Of] = UNITS, **recovery: Any) -> Agent:
        agent = Agent(units, self.containers, self.clock, folder=self.folder, **{**RULES, **recovery})
        self.agents.append(agent)
        return agent

    def given_up(self, **recovery: Any) -> Agent:
        """PHM has tried `same_failure` times and reported that it gave up."""
        agent = self.phm(**recovery)
        agent.rest(3.0)
        agent.bad["health/app"] = "broken"
        agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
        return agent


@pytest.fixture
def yard(tmp_path: Path) -> Iterator[Yard]:
    made = Yard(tmp_path)
    yield made
    for agent in made.agents:
        agent.stop()
    made.clock.advance(1000)


def test_recovery_resumes_after_giving_up_when_the_container_was_recreated(yard: Yard) -> None:
    """Reported once for each container: an operator who recreates it wants to know whether that helped."""
    agent = yard.given_up()
    agent.rest(20.0)
    assert (len(agent.runs), agent.opened()) == (2, ["health/app"])
    yard.containers.recreate("app")
    agent.until(lambda: len(agent.runs) == 4, "two more attempts")
    agent.until(lambda: agent.steps().count(Phase.ESCALATED) == 2, "giving up again")
    agent.rest(20.0)
    assert (len(agent.runs), agent.opened()) == (4, ["health/app"] * 2)
    assert any("started again outside PHM" in note for note in agent.notes())


def test_a_unit_whose_fault_is_cleared_gets_its_grace(yard: Yard) -> None:
    """The new container has just been started: a missing unit is not known to be a fault yet."""
    agent = yard.given_up(units={"health/app": Of("app", grace_s=6.0)})
    yard.containers.recreate("app")
    recreated = yard.clock.mono()
    agent.until(lambda: len(agent.opened()) == 2, "the second alarm")
    assert yard.clock.mono() - recreated >= 6.0


def test_recovery_resumes_after_a_manual_start_that_lasts(yard: Yard) -> None:
    """Not before it has run for `recovery.verify`."""
    agent = yard.given_up()
    agent.rest(1.0)
    yard.containers.start("app")
    agent.rest(4.0)
    assert len(agent.runs) == 2
    agent.until(lambda: len(agent.runs) == 3, "another attempt")


Loop = Callable[[Containers], None]


def by_policy(containers: Containers) -> None:
    containers.start("app", by_policy=True)


def by_a_supervisor(containers: Containers) -> None:
    containers.start("app")


def with_a_new_container(containers: Containers) -> None:
    containers.recreate("app")


@pytest.mark.parametrize(
    ("loop", "life_s", "more"),
    [(by_policy, 1.0, 0), (by_policy, 8.0, 0), (by_a_supervisor, 1.0, 0), (with_a_new_container, 1.0, 2)],
)
def test_a_crash_loop_does_not_reset_attempts_each_time(yard: Yard, loop: Loop, life_s: float, more: int) -> None:
    """Docker's restart policy never counts, nor a supervisor's loop while lives are short; a new id counts once."""
    agent = yard.given_up()
    before = len(agent.runs)
    for _ in range(round(60.0 / life_s)):
        loop(yard.containers)
        agent.rest(life_s - 0.5)
        yard.containers.end("app")
        agent.rest(0.5)
    assert len(agent.runs) == before + more


def test_the_budget_counts_attempts_on_earlier_lives(yard: Yard) -> None:
    """However often it is recreated: no more actions within the window than allowed."""
    agent = yard.given_up(budget=3, reserve=0)
    yard.containers.recreate("app")
    agent.until(lambda: Phase.REFUSED in agent.steps(), "the end of the budget")
    for _ in range(3):
        agent.rest(10.0)
        yard.containers.recreate("app")
    agent.rest(20.0)
    assert len(agent.runs) == 3


def test_back_off_ends_with_the_containers_life(yard: Yard) -> None:
    """An open fault waits a minute for its next attempt; on a new container it is checked again, after its grace."""
    agent = yard.phm(backoff=60.0, backoff_max=60.0)
    agent.rest(3.0)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.FAILED in agent.steps(), "an attempt that fails")
    agent.rest(3.0)
    assert len(agent.runs) == 1
    recreated = yard.clock.mono()
    yard.containers.recreate("app")
    agent.until(lambda: len(agent.runs) == 2, "another attempt")
    assert 2.0 <= yard.clock.mono() - recreated < 30.0
    assert agent.opened() == ["health/app"]


def test_an_external_restart_ends_the_verification(yard: Yard) -> None:
    """An operator restarts the container while PHM waits: that attempt is over, and the container gets its grace."""
    agent = yard.phm(verify=60.0)
    agent.rest(3.0)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.DONE in agent.steps(), "the action")
    agent.rest(1.5)
    yard.containers.start("app")
    restarted = yard.clock.mono()
    agent.until(lambda: Phase.FAILED in agent.steps(), "the end of the verification")
    details = [event.detail for event in agent.of(ActionEvent) if event.phase is Phase.FAILED]
    assert details == ["app was started again outside PHM before restart was verified"]
    agent.until(lambda: len(agent.runs) == 2, "another attempt")
    assert yard.clock.mono() - restarted >= 2.0


def test_a_restart_by_docker_does_not_end_the_verification(yard: Yard) -> None:
    """It came up at the second try, by its restart policy, which also counts as success."""
    agent = yard.phm(verify=60.0)
    agent.rest(3.0)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.DONE in agent.steps(), "the action")
    agent.rest(1.0)
    yard.containers.start("app", by_policy=True)
    agent.rest(1.0)
    agent.bad.clear()
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the verification")
    assert Phase.FAILED not in agent.steps()


def test_a_restart_by_phm_does_not_reset_attempts(yard: Yard) -> None:
    """Otherwise every attempt would discount the previous one."""
    agent = yard.given_up(verify=1.0)
    agent.rest(60.0)
    assert len(agent.runs) == 2


def test_the_engine_is_asked_once_for_each_look_at_the_container(yard: Yard) -> None:
    """Ten minutes long after a recovery, on a computer that flies: each request costs PHM and the engine CPU time."""
    agent = yard.given_up()
    agent.rest(5.0)
    before = yard.containers.asked
    agent.rest(10 * GENERATION_S)
    assert yard.containers.asked - before <= 11


def test_a_recreation_is_detected_over_a_restart_of_phm(yard: Yard) -> None:
    """The life on which PHM gave up is saved on disk."""
    yard.given_up().stop()
    second = yard.phm()
    second.bad["health/app"] = "broken"
    second.rest(10.0)
    assert second.runs == []
    second.stop()
    yard.containers.recreate("app")
    third = yard.phm()
    third.bad["health/app"] = "broken"
    third.until(lambda: len(third.runs) == 2, "two more attempts")
    third.until(lambda: Phase.ESCALATED in third.steps(), "giving up again")
    third.stop()
    fourth = yard.phm()
    fourth.bad["health/app"] = "broken"
    fourth.rest(10.0)
    assert fourth.runs == []


def test_a_manual_start_counts_over_a_restart_of_phm(yard: Yard) -> None:
    """The time for which the container has been up continues."""
    first = yard.given_up(verify=30.0)
    yard.containers.start("app")
    first.rest(5.0)
    first.stop()
    second = yard.phm(verify=30.0)
    second.bad["health/app"] = "broken"
    second.rest(20.0)
    assert second.runs == []
    second.until(lambda: second.runs, "another attempt")


def test_the_hold_of_an_interrupted_action_ends_with_the_containers_life(yard: Yard) -> None:
    """PHM was killed during the action. The container is recreated: a later failure is a separate fault."""
    units = {**UNITS, "files/app": Of("app")}
    first = yard.phm(units=units)
    first.rest(3.0)
    first.behave = lambda key, context, fault: first.pause(lambda: False)
    first.bad["health/app"] = "broken"
    first.until(lambda: first.runs, "the action")
    first.stop()
    second = yard.phm(units=units, mode="off")
    second.bad["health/app"] = "broken"
    second.rest(3.0)
    second.bad["files/app"] = "broken"
    second.rest(5.0)
    assert second.opened() == []
    yard.containers.recreate("app")
    second.rest(5.0)
    assert second.opened() == ["files/app"]


def test_a_start_long_before_the_first_attempt_resets_nothing(yard: Yard) -> None:
    """Ten minutes without faults lie between: its lives were not tracked, and the attempt is made on the current one."""
    agent = yard.phm(same_failure=1)
    agent.rest(3.0)
    agent.bad["health/app"] = "broken"
    agent.behave = lambda key, context, fault: agent.bad.clear()
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the help")
    yard.clock.advance(700.0)
    agent.rest(3.0)
    yard.containers.start("app")
    yard.clock.advance(700.0)
    agent.behave = lambda key, context, fault: None
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    agent.rest(30.0)
    assert len(agent.runs) == 2


def late(agent: Agent) -> None:
    """The engine does not answer within the deadline, but still restarts the container, one restart at a time."""

    agent.engine.fails = LATE
    agent.behave = lambda key, context, fault: context.engine.restart(key)


def test_a_restart_that_the_engine_finishes_late_resets_no_attempt(yard: Yard) -> None:
    """It is PHM's own: after three equal failures PHM gives up, however long the last life lasts."""
    agent = yard.phm(same_failure=3, backoff=15.0, backoff_max=15.0)
    agent.rest(3.0)
    late(agent)
    agent.bad["health/app"] = "broken"
    for number in (1, 2, 3):
        agent.until(lambda count=number: len(agent.runs) == count, f"attempt {number}")  # type: ignore[misc]
        agent.rest(1.0)
        yard.containers.end("app")
        agent.rest(1.0)
        yard.containers.start("app")
        agent.rest(8.0)  # longer than `verify`
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    agent.rest(60.0)
    assert (len(agent.runs), agent.opened()) == (3, ["health/app"])
    assert not any("outside PHM" in note for note in agent.notes())


def test_a_container_that_starts_late_gets_its_grace(yard: Yard) -> None:
    """The engine finishes the first restart after its deadline: the container is not restarted again while it starts."""
    agent = yard.phm(units={"health/app": Of("app", grace_s=6.0)}, backoff=4.0)
    agent.rest(10.0)
    late(agent)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.FAILED in agent.steps(), "the deadline")
    agent.rest(3.0)
    yard.containers.start("app")
    agent.rest(5.0)
    agent.bad.clear()
    agent.until(lambda: not agent.pipeline.open_faults(), "its being OK")
    assert len(agent.runs) == 1


@pytest.mark.parametrize("while_away", [True, False])
def test_a_restart_interrupted_by_phms_end_resets_no_attempt(yard: Yard, while_away: bool) -> None:
    """The engine finishes it before the next PHM's first check, or a minute later: it is PHM's own."""
    first = yard.phm(same_failure=3)
    first.rest(3.0)
    first.behave = lambda key, context, fault: first.pause(lambda: False)
    first.bad["health/app"] = "broken"
    first.until(lambda: first.runs, "the action")
    first.stop()
    if while_away:
        yard.containers.start("app")
    second = yard.phm(same_failure=3, backoff=60.0, backoff_max=60.0)
    second.bad["health/app"] = "broken"
    second.rest(40.0)
    if not while_away:
        yard.containers.start("app")
    second.until(lambda: Phase.ESCALATED in second.steps(), "giving up")
    second.rest(60.0)
    assert (len(second.runs), second.opened()) == (2, [])
    assert not any("outside PHM" in note for note in second.notes())


def test_a_dependents_restart_interrupted_by_phms_end_is_phms_own(yard: Yard) -> None:
    """PHM's attempts on the dependent itself still count."""
    yard.containers.facts["side"] = testing.container("side")
    units = {**UNITS, "health/side": Of("side", grace_s=2.0)}
    first = yard.phm(units=units, opted_in=("app", "side"))
    first.rest(3.0)
    first.bad["health/side"] = "broken"
    first.until(lambda: Phase.ESCALATED in first.steps("side"), "giving up on side")

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        with context.lock_dependent("side", fault, "restart", 30.0):
            first.pause(lambda: False)

    first.behave = act
    first.bad["health/app"] = "broken"
    first.until(lambda: first.executor.persisted().unfinished == {"app": "app", "side": "app"}, "the action")
    first.stop()
    yard.containers.start("side")
    second = yard.phm(units=units, opted_in=("app", "side"))
    second.bad["health/side"] = "broken"
    second.rest(60.0)
    assert [target for target, _ in second.runs] == []
    assert not any("outside PHM" in note for note in second.notes())


@pytest.mark.parametrize("while_away", [False, True])
def test_an_operators_stop_after_an_interrupted_restart_is_not_phms_own(yard: Yard, *, while_away: bool) -> None:
    """The engine has completed the restart of the dependent, which has no fault and no attempts."""
    yard.containers.facts["side"] = testing.container("side")
    first = yard.phm()
    first.rest(3.0)

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        with context.lock_dependent("side", fault, "restart", 30.0):
            first.pause(lambda: False)

    first.behave = act
    first.bad["health/app"] = "broken"
    first.until(lambda: "side" in first.executor.persisted().unfinished, "the action")
    first.stop()
    if while_away:
        yard.containers.start("side")
    second = yard.phm()
    if not while_away:
        second.rest(10.0)
        assert second.executor.action_on("side")
        yard.containers.start("side")
    second.rest(10.0)
    assert not second.executor.action_on("side")


def test_an_operators_stop_after_an_unanswered_restart_is_not_phms_own(yard: Yard) -> None:
    """Once the engine has completed the restart of the dependent, which has no fault and no attempts."""
    yard.containers.facts["side"] = testing.container("side")
    agent = yard.phm()
    agent.rest(3.0)
    agent.engine.fails = LATE

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        with context.lock_dependent("side", fault, "restart", 30.0), contextlib.suppress(EngineTimeout):
            context.engine.restart("side")
        agent.bad.clear()

    agent.behave = act
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the action")
    agent.rest(10.0)
    assert agent.executor.action_on("side")
    yard.containers.start("side")
    agent.rest(10.0)
    assert not agent.executor.action_on("side")


@pytest.mark.parametrize(
    ("call", "fails", "own"),
    [("inspect", LATE, False), ("restart", LATE, True), ("restart", BROKEN, True), ("restart", ABSENT, False)],
)
def test_only_an_unanswered_start_is_attributed_to_phm(yard: Yard, call: str, fails: EngineError, own: bool) -> None:
    """An operator's stop after any other failed call is not attributed to PHM."""
    agent = yard.phm(backoff=600.0, backoff_max=600.0)
    agent.rest(3.0)
    agent.engine.fails = fails
    agent.behave = lambda key, context, fault: getattr(context.engine, call)(key)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.FAILED in agent.steps(), "the deadline")
    agent.rest(3.0)
    assert agent.executor.action_on("app") is own


def test_an_external_stop_during_a_relaunch_is_not_phms_own(yard: Yard) -> None:
    """An operator's `docker stop` during a relaunch is a manual stop."""
    agent = yard.phm(actions=("relaunch",), ladders={"broken": ["relaunch"]})
    agent.rest(3.0)
    seen: list[bool] = []
    agent.behave = lambda key, context, fault: seen.append(agent.executor.action_on("app"))
    agent.bad["health/app"] = "broken"
    agent.until(lambda: seen, "the action")
    assert seen == [False]


def test_an_external_stop_before_phm_stops_the_container_is_not_phms_own(yard: Yard) -> None:
    """Such as while it reconnects the container's networks, before it restarts it."""
    agent = yard.phm()
    agent.rest(3.0)
    seen: list[bool] = []

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        seen.append(agent.executor.action_on("app"))
        context.engine.restart(key)
        seen.append(agent.executor.action_on("app"))

    agent.behave = act
    agent.bad["health/app"] = "broken"
    agent.until(lambda: len(seen) > 1, "the action")
    assert seen[:2] == [False, True]


def test_an_external_stop_beside_the_restart_of_a_dependent_is_not_phms_own(yard: Yard) -> None:
    """What an action has restarted already is an operator's to stop, and so is a dependent until its turn."""
    yard.containers.facts["side"] = testing.container("side")
    agent = yard.phm()
    agent.rest(3.0)
    seen: list[tuple[bool, bool]] = []

    def look() -> None:
        seen.append((agent.executor.action_on("app"), agent.executor.action_on("side")))

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        context.engine.restart(key)
        done_at = agent.clock.mono()
        look()
        with context.lock_dependent("side", fault, "restart", 30.0):
            agent.pause(lambda: agent.clock.mono() - done_at > SETTLED_S)
            look()
            context.engine.restart("side")
            look()
        agent.bad.clear()

    agent.behave = act
    agent.bad["health/app"] = "broken"
    agent.until(lambda: len(seen) == 3, "the action")
    assert seen == [(True, False), (False, False), (False, True)]


@pytest.mark.parametrize("action", ["relaunch", "restart"])
def test_only_an_interrupted_start_is_attributed_to_phm(yard: Yard, action: str) -> None:
    """The engine cannot finish a start that was not requested."""
    ladder = {"actions": (action,), "ladders": {"broken": [action]}}
    first = yard.phm(**ladder)
    first.rest(3.0)
    first.behave = lambda key, context, fault: first.pause(lambda: False)
    first.bad["health/app"] = "broken"
    first.until(lambda: first.runs, "the action")
    first.stop()
    second = yard.phm(**ladder)
    assert second.executor.action_on("app") is (action == "restart")
