"""Whether the vehicle counts as armed: only a recent disarmed heartbeat of its own autopilot lifts the restriction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from phm.core.model import Fault, Phase
from phm.facts.links import AutopilotFact
from phm.recovery.base import ActionContext, FlightCriticalError
from phm.recovery.safety.armed_state import ArmedMonitor, ArmedState, LastArmedState, assess
from phm.reporters.flights import FlightChange, FlightCounter
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

TIMEOUT_S = 3.5
FLEW = LastArmedState(True, 0.0)
"""The state that an earlier run of PHM saved."""


def fact(armed_s: float | None, disarmed_s: float | None, **more: object) -> AutopilotFact:
    ages = [age for age in (armed_s, disarmed_s) if age is not None]
    armed = armed_s is not None and (disarmed_s is None or armed_s <= disarmed_s)
    return AutopilotFact(min(ages), armed, armed_s=armed_s, disarmed_s=disarmed_s, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "last", "state", "words"),
    [
        (None, None, ArmedState.UNKNOWN, "no heartbeat of the autopilot was received"),
        (None, LastArmedState(True, 0.0), ArmedState.ARMED, "since PHM started, and it was armed before"),
        (None, LastArmedState(False, 0.0), ArmedState.UNKNOWN, "since PHM started"),
        (fact(None, 0.5), None, ArmedState.DISARMED, "disarmed"),
        (fact(60.0, 0.5, disarmed_for_s=59.0), FLEW, ArmedState.DISARMED, "disarmed"),
        (fact(2.0, 0.5, disarmed_for_s=1.0), FLEW, ArmedState.ARMED, "reported armed 2.0 s ago"),
        (fact(4.0, 0.5, disarmed_for_s=3.0), FLEW, ArmedState.DISARMED, "disarmed"),
        (fact(8.0, 0.5, disarmed_for_s=1.0), FLEW, ArmedState.ARMED, "may have rebooted in the air"),
        (fact(38.0, 0.5, disarmed_for_s=31.0), FLEW, ArmedState.DISARMED, "disarmed"),
        (fact(8.0, 0.5, disarmed_for_s=1.0), LastArmedState(False, 0.0), ArmedState.DISARMED, "disarmed"),
        (fact(0.5, None), None, ArmedState.ARMED, "is armed"),
        (fact(0.5, 60.0), None, ArmedState.ARMED, "is armed"),
        (fact(12.0, None), None, ArmedState.ARMED, "silent for 12 s and was armed"),
        (fact(None, 12.0), None, ArmedState.UNKNOWN, "silent for 12 s"),
        (fact(None, 3.6), None, ArmedState.UNKNOWN, "silent for 4 s"),
        (fact(1.0, 0.5), None, ArmedState.ARMED, "armed 1.0 s ago and disarmed 0.5 s ago"),
        (fact(None, 0.5, stalled_s=1.0), None, ArmedState.UNKNOWN, "PHM was suspended"),
        (fact(None, 0.5, stalled_s=4.0), None, ArmedState.DISARMED, "disarmed"),
        (fact(9.0, 0.5, rebooted_s=5.0, rebooted_armed=True), None, ArmedState.ARMED, "rebooted while armed 5 s ago"),
        (fact(9.0, 0.5, rebooted_s=31.0, rebooted_armed=True), None, ArmedState.DISARMED, "disarmed"),
        (fact(9.0, 0.5, rebooted_s=5.0, rebooted_armed=False), None, ArmedState.DISARMED, "disarmed"),
        (fact(None, 0.5, disarmed_for_s=29.0), FLEW, ArmedState.ARMED, "may have rebooted in the air"),
        (fact(None, 0.5, disarmed_for_s=31.0), FLEW, ArmedState.DISARMED, "disarmed"),
        (fact(None, 0.5, boot_s=12.0, boot_age_s=0.5), FLEW, ArmedState.ARMED, "may have rebooted in the air"),
        (
            fact(None, 0.5, boot_s=12.0, boot_age_s=0.5, disarmed_for_s=60.0),
            FLEW,
            ArmedState.ARMED,
            "may have rebooted",
        ),
        (fact(None, 0.5, boot_s=600.0, boot_age_s=0.5), FLEW, ArmedState.DISARMED, "disarmed"),
        (fact(None, 0.5, boot_s=600.0, boot_age_s=9.0), FLEW, ArmedState.ARMED, "may have rebooted in the air"),
        (fact(None, 0.5, boot_s=12.0, boot_age_s=0.5), LastArmedState(False, 0.0), ArmedState.DISARMED, "disarmed"),
    ],
)
def test_only_a_recent_disarmed_lifts_the_restriction(
    given: AutopilotFact | None, last: LastArmedState | None, state: ArmedState, words: str
) -> None:
    """Never received, silent, contradictory, read late, or just rebooted in flight: restricted, with the reason."""
    found = assess(given, TIMEOUT_S, last)
    assert found.state is state
    assert found.restricts is (state is not ArmedState.DISARMED)
    assert words in found.why


def test_a_suspension_of_phm_leaves_it_undecided_for_a_known_time() -> None:
    """However many heartbeats arrive meanwhile: an action may wait for that. Any other state may change with the next one."""
    assert assess(fact(None, 0.5, stalled_s=1.0), TIMEOUT_S).undecided_s == 2.5
    assert assess(fact(None, 12.0), TIMEOUT_S).undecided_s == 0.0
    assert assess(fact(None, 0.5), TIMEOUT_S).undecided_s == 0.0


def test_a_long_timeout_does_not_take_a_reboot_for_a_landing() -> None:
    """`autopilot_timeout` 10 s: a real reboot is silent for 6.5 s."""
    given = fact(10.2, 0.5, disarmed_for_s=3.7)
    assert assess(given, 10.0, FLEW).state is ArmedState.ARMED
    assert assess(replace(given, armed_s=10.2, disarmed_for_s=9.2), 10.0, FLEW).state is ArmedState.DISARMED


def test_the_last_certain_state_is_saved_with_its_beginning() -> None:
    """It changes only with the state, so that it is not written repeatedly; an unknown state changes nothing."""
    clock, seen = FakeClock(), [fact(0.1, None)]
    monitor = ArmedMonitor(lambda: seen[0], TIMEOUT_S, clock)
    began = clock.mono()
    assert monitor.kept() == LastArmedState(True, began)
    clock.advance(5.0)
    assert monitor.kept() == LastArmedState(True, began)
    seen[0] = fact(None, 9.0)
    assert monitor.kept() == LastArmedState(True, began)
    seen[0] = fact(9.0, 0.1, disarmed_for_s=8.0)
    assert monitor.kept() == LastArmedState(False, clock.mono())


def test_a_restart_of_phm_in_flight_lifts_no_restriction(tmp_path: Path) -> None:
    """An armed vehicle stays armed until the autopilot reports disarmed and has not just booted; the flight-critical
    container is left alone.
    """
    clock, containers, facts = FakeClock(), Containers("app"), [fact(0.1, None)]

    def life() -> Agent:
        monitor = ArmedMonitor(lambda: facts[0] if facts else None, TIMEOUT_S, clock)
        return Agent(
            {"container/app": Of("app")}, containers, clock, folder=tmp_path, critical=("app",), monitor=monitor
        )

    first = life()
    first.rest(2.0)
    first.stop()
    facts.clear()
    second = life()
    second.bad["container/app"] = "broken"
    second.rest(30.0)
    assert second.runs == []
    assert any("it was armed before" in event.detail for event in second.actions())
    facts.append(fact(None, 0.1, boot_s=5.0, boot_age_s=0.1))
    second.rest(30.0)
    assert second.runs == []
    facts[:] = [fact(None, 0.1, boot_s=35.0, boot_age_s=0.1)]
    second.until(lambda: second.runs == [("app", "container/app")], "the restart after the fresh disarmed")
    second.stop()


@pytest.fixture
def agents() -> Iterator[list[Agent]]:
    made: list[Agent] = []
    yield made
    for agent in made:
        agent.stop()


def test_an_action_that_would_cut_a_flight_critical_network_is_only_advised(agents: list[Agent]) -> None:
    """The container itself is not flight-critical, but another one shares its network; on the ground it is restarted."""
    containers = Containers("app", "pilot")
    owner = containers.facts["app"].id
    containers.facts["pilot"] = replace(containers.facts["pilot"], network_mode=f"container:{owner}")
    made = Agent({"container/app": Of("app")}, containers, FakeClock(), critical=("pilot",))
    agents.append(made)
    made.armed = True
    made.bad["container/app"] = "broken"
    made.rest(20.0)
    made.until(lambda: made.actions() != [], "the advice")  # the bus delivers it in a separate thread
    assert made.runs == []
    assert "would take down pilot, which is flight-critical" in made.actions()[0].detail
    made.armed = False
    made.until(lambda: made.runs == [("app", "container/app")], "the restart after landing")


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        (None, None),
        (fact(None, 0.5, disarmed_for_s=29.0), None),
        (fact(None, 0.5, disarmed_for_s=31.0), False),
        (fact(None, 12.0), None),
        (fact(0.5, None), True),
        (fact(12.0, None), True),
        (fact(9.0, 0.5, rebooted_s=5.0, rebooted_armed=True), None),
    ],
)
def test_what_an_earlier_run_knew_is_not_reported_as_armed(given: AutopilotFact | None, reported: bool | None) -> None:
    """Recovery relies on it, but the log would say that the flight lasted until PHM started again."""
    monitor = ArmedMonitor(lambda: given, TIMEOUT_S, FakeClock())
    monitor.restore(FLEW)
    assert monitor.reported() is reported


def test_a_flight_that_a_loss_of_power_cut_does_not_continue_at_the_next_boot(tmp_path: Path) -> None:
    """The first heartbeats say disarmed: recovery waits with them as in the air, and the log says only that it ended."""
    FlightCounter(str(tmp_path)).update(True, 0.0)
    heard: list[AutopilotFact | None] = [None]
    monitor, counter = ArmedMonitor(lambda: heard[-1], TIMEOUT_S, FakeClock()), FlightCounter(str(tmp_path))
    monitor.restore(FLEW)
    marks = []
    for seconds in range(40):
        marks.append(counter.update(monitor.reported(), float(seconds)))
        heard.append(fact(None, 0.5, disarmed_for_s=float(seconds)))
    assert [mark for mark in marks if mark is not None] == [FlightChange(1, began=False)]


def test_arming_during_an_action_is_not_a_failure_of_the_container(agents: list[Agent]) -> None:
    """The action is refused and advised, and does not count as a failed attempt."""
    made = Agent({"container/app": Of("app")}, Containers("app"), FakeClock(), critical=("app",))
    agents.append(made)

    def armed_meanwhile(key: str, context: ActionContext, fault: Fault) -> None:
        if len(made.runs) <= 4:
            made.armed = True
            raise FlightCriticalError("restart of app was not done")
        made.bad.clear()

    made.behave = armed_meanwhile
    made.bad["container/app"] = "broken"
    for runs in range(1, 5):
        made.until(lambda wanted=runs: len(made.runs) == wanted, f"attempt {runs}")  # type: ignore[misc]
        made.until(lambda: made.steps()[-1] in (Phase.REFUSED, Phase.ADVISED), "the refusal")
        made.armed = False
    made.until(lambda: made.closed(), "the recovery on the ground")
    assert Phase.ESCALATED not in made.steps()
    assert made.steps()[:3] == [Phase.STARTED, Phase.REFUSED, Phase.ADVISED]
