"""A restart that an operator requests: executed like any other, and restricted by the same rules."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.core.model import ActionEvent, Phase
from phm.core.settings import ContainerSettings, RecoverySettings
from phm.recovery.base import Target
from phm.recovery.executor import NotAllowed, NotNow
from phm.recovery.fault_cases import AttemptRecord, History
from phm.recovery.operator.requests import check_permitted
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of


@pytest.fixture
def agents() -> Iterator[list[Agent]]:
    made: list[Agent] = []
    yield made
    for agent in made:
        agent.stop()


def agent(agents: list[Agent], *keys: str, **options: object) -> Agent:
    names = keys or ("app",)
    units = {f"container/{key}": Of(key) for key in names}
    made = Agent(units, Containers(*names), FakeClock(), **options)  # type: ignore[arg-type]
    agents.append(made)
    made.step()
    return made


def phases(made: Agent) -> list[Phase]:
    return [event.phase for event in made.of(ActionEvent)]


def test_a_requested_restart_is_verified_and_opens_no_fault(agents: list[Agent]) -> None:
    """All steps: started, done, verified; it counts in the budget."""
    made = agent(agents)
    assert made.executor.restart("app", "255/190") == "restart app, requested by 255/190"
    made.rest(5.0)
    assert made.runs == [("app", "container/app")]
    assert phases(made) == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    assert "requested by 255/190" in made.of(ActionEvent)[0].detail
    assert made.opened() == []
    assert [attempt.condition for attempt in made.executor.persisted().attempts["app"]] == ["restart_requested"]


def test_a_container_that_has_not_opted_in_is_left_alone(agents: list[Agent]) -> None:
    """A request does not replace `recover: true`."""
    made = agent(agents, opted_in=())
    with pytest.raises(NotAllowed, match="has not opted in"):
        made.executor.restart("app", "255/190")
    made.rest(2.0)
    assert made.runs == []


def test_recovery_that_is_off_stays_off(agents: list[Agent]) -> None:
    """Mode `off` means that PHM changes nothing; `advise` leaves the decision to the operator, who has made it."""
    off, advise = agent(agents, mode="off"), agent(agents, mode="advise")
    with pytest.raises(NotAllowed, match="recovery is off"):
        off.executor.restart("app", "255/190")
    advise.executor.restart("app", "255/190")
    advise.rest(3.0)
    assert (off.runs, advise.runs) == ([], [("app", "container/app")])


def test_the_budget_applies_to_requested_restarts(agents: list[Agent]) -> None:
    """The answer states for how long it is used up."""
    made = agent(agents, budget=2)
    for _ in range(2):
        made.executor.restart("app", "255/190")
        made.rest(5.0)
    with pytest.raises(NotNow, match="budget of 2 actions"):
        made.executor.restart("app", "255/190")
    made.rest(2.0)
    assert len(made.runs) == 2


def test_the_budget_of_restarts_leaves_out_what_disturbs_no_container() -> None:
    """`relieve` lowers the CPU weight of others, `join_network` connects PHM. Where more was done than the budget allows, the newest of it count."""
    target, settings = Target.of(ContainerSettings(name="app", recover=True)), RecoverySettings(budget=2, window=600.0)
    gentle = [AttemptRecord(100.0 + at, "pressure/app", "cpu_starved", "relieve", True) for at in range(5)]
    check_permitted(target, History(gentle), 200.0, forbidden="", settings=settings)
    own = [AttemptRecord(100.0 + at, "network/app", "sidecar_disconnected", "join_network", True) for at in range(5)]
    unrestricted = frozenset({"join_network"})
    check_permitted(target, History(own), 200.0, forbidden="", settings=settings, unrestricted=unrestricted)
    starts = [AttemptRecord(at, "container/app", "exited", "start", False) for at in (100.0, 150.0, 190.0)]
    with pytest.raises(NotNow, match="used up for 550 s"):
        check_permitted(target, History(starts), 200.0, forbidden="", settings=settings)


def test_a_flight_critical_container_is_left_alone_in_flight(agents: list[Agent]) -> None:
    """Also when the autopilot is armed between the request and the action."""
    made = agent(agents, critical=("app",))
    made.armed = True
    with pytest.raises(NotNow, match="flight-critical"):
        made.executor.restart("app", "255/190")
    made.rest(2.0)
    made.armed = False
    made.executor.restart("app", "255/190")
    made.rest(5.0)
    assert made.runs == [("app", "container/app")]


def test_a_second_restart_is_denied_while_one_is_running(agents: list[Agent]) -> None:
    """It can be requested again later."""
    made = agent(agents)
    made.executor.restart("app", "255/190")
    with pytest.raises(NotNow, match="is under way"):
        made.executor.restart("app", "255/190")


def test_a_container_that_is_not_configured_is_rejected(agents: list[Agent]) -> None:
    """And no thread is created for it."""
    made = agent(agents)
    with pytest.raises(NotAllowed, match="no container 'other'"):
        made.executor.restart("other", "255/190")
    assert "other" not in made.executor._workers


def test_an_ineffective_restart_becomes_a_fault_of_the_container(agents: list[Agent]) -> None:
    """It ends and stays down: reported as failed, and then recovered by its own ladder."""
    made = agent(agents)

    def behave(key: str, context: object, fault: object) -> None:
        made.bad.clear()
        if len(made.runs) == 1:
            made.bad["container/app"] = "broken"
        made.pause(lambda: True)  # results from before the end of the action prove nothing

    made.behave = behave
    made.executor.restart("app", "255/190")
    made.rest(60.0)
    assert Phase.FAILED in phases(made)
    assert phases(made)[-1] is Phase.VERIFIED
    assert len(made.runs) == 2


def test_a_restart_that_waits_for_a_network_is_reported_once_and_expires(agents: list[Agent]) -> None:
    """It waits for the lifetime of an approval, `recovery.approval`."""
    made = agent(agents, approval="30s")
    made.missing = "there is no network swarm"
    made.executor.restart("app", "255/190")
    made.rest(20.0)
    assert [event.detail for event in made.of(ActionEvent)] == ["no action on app for now: there is no network swarm"]
    made.rest(60.0)
    assert phases(made) == [Phase.REFUSED, Phase.REFUSED]
    assert "it was not possible within 30 s" in made.of(ActionEvent)[1].detail
    made.missing = ""
    made.rest(5.0)
    assert made.runs == []


def test_a_restart_that_waits_for_a_network_is_done_when_it_exists(agents: list[Agent]) -> None:
    """Faults of the container are handled meanwhile."""
    made = agent(agents)
    made.missing = "there is no network swarm"
    made.executor.restart("app", "255/190")
    made.rest(5.0)
    made.missing = ""
    made.until(lambda: Phase.VERIFIED in phases(made), "the restart")
    assert phases(made) == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]
