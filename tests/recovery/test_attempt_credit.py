"""Which cause a fault's resolution names: an action only where the evidence supports it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from phm import testing
from phm.core.model import ActionEvent, Fault, Layer, Level, Phase, Result, Slot, Stamp
from phm.facts import AutopilotFact, LinkFact
from phm.recovery.actions.reopen import BEHIND_S, BOOT_S, PROMPT_S, Reopen
from phm.recovery.base import ActionContext, NotNeeded, Target, TargetKind
from phm.runtime.sections import action_settings
from phm.testing import settings
from tests.recovery.simulated_agent import Agent, Containers, Of

# ---------------------------------------------------------------- any action


@pytest.fixture
def agent() -> Iterator[Agent]:
    made = Agent({"health/app": Of("app")}, Containers("app"), testing.FakeClock(), verify=5.0, backoff=0.1)
    yield made
    made.stop()
    made.clock.advance(1000)


def resolved(agent: Agent, behave: Callable[..., object]) -> tuple[str, str]:
    """The cause of the resolution, and the message about the action."""
    agent.rest(3.0)
    agent.behave = behave
    agent.bad["health/app"] = "broken"
    agent.until(agent.closed, "the end of the fault")
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the message about the action")
    said = [event.detail for event in agent.of(ActionEvent) if event.phase is Phase.VERIFIED]
    return agent.closed()[0].fault.by, said[0]


def test_an_effective_action_is_credited(agent: Agent) -> None:
    """An action after which the unit is OK is named as the one that ended the fault."""
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "restart"
    assert "not credited" not in said


def test_an_action_that_found_nothing_to_do_is_not_credited(agent: Agent) -> None:
    """An operator was faster: the container ran, the file existed."""

    def nothing(key: str, context: ActionContext, fault: Fault) -> NotNeeded:
        agent.bad.clear()
        return NotNeeded("app is already running")

    by, said = resolved(agent, nothing)
    assert by == "itself"
    assert said.endswith("not credited to restart: no action was needed")


def test_an_action_that_found_nothing_to_do_is_credited_for_no_other_fault() -> None:
    """Another fault of the container ends at the same time, by itself too."""
    units = {"container/app": Of("app"), "files/app": Of("app", grace_s=3.0)}
    agent = Agent(units, Containers("app"), testing.FakeClock(), verify=5.0)

    def nothing(key: str, context: ActionContext, fault: Fault) -> NotNeeded:
        del agent.bad["container/app"]
        return NotNeeded("app is already running")

    agent.rest(4.0)
    agent.behave = nothing
    agent.bad["files/app"] = "only reported"
    agent.rest(2.0)
    agent.bad["container/app"] = "broken"
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the message about the action")
    agent.bad.clear()
    agent.until(lambda: len(agent.closed()) == 2, "the end of both faults")
    agent.stop()
    agent.clock.advance(1000)
    assert [event.fault.by for event in agent.closed()] == ["itself", "itself"]


def test_an_action_may_report_another_cause(agent: Agent) -> None:
    """The fault then ended by itself, and the log gives the cause."""
    agent.other_cause = lambda: "the moon has moved"
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "itself"
    assert said.endswith("not credited to restart: the moon has moved")


def test_an_action_is_credited_when_no_thread_can_be_started_to_query_other_causes(
    agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a limit of processes there is no evidence against the action."""
    begin = threading.Thread.start

    def start(thread: threading.Thread) -> None:
        if thread.name.startswith("phm-credit"):
            raise RuntimeError("can't start new thread")
        begin(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "restart"
    assert "not credited" not in said


# ---------------------------------------------------------------- a link


class Running(testing.FakeClock):
    """A clock that advances while a thread waits."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.advance(timeout_s or 0.0)
        return event.is_set()


@dataclass
class Cable:
    """A link that is silent for `silent_s`. `speaks_after_s`: data arrive this long after it was reopened."""

    speaks_after_s: float = 0.3
    silent_s: float = 10.0
    pilot: AutopilotFact | None = None
    boot_after_s: float = 0.5
    """The time after which the autopilot reports a time since boot again."""
    boots: Callable[[float], dict[str, Any]] = lambda elapsed_s: {}
    """Its change then, by the time since the action began."""
    clock: Running = field(default_factory=Running)
    opened: float | None = None
    began: float = 1000.0
    reopen_hook: Callable[[], None] = lambda: None

    def link(self, name: str) -> LinkFact:
        since = self.clock.mono() - (self.opened if self.opened is not None else self.clock.mono())
        came = self.opened is not None and since >= self.speaks_after_s
        return LinkFact(name, open=True, rx_age_s=since - self.speaks_after_s if came else self.silent_s + since)

    def autopilot(self) -> AutopilotFact | None:
        elapsed_s = self.clock.mono() - self.began
        if self.pilot is None or self.pilot.boot_s is None:
            return self.pilot
        aged = replace(self.pilot, boot_s=self.pilot.boot_s + elapsed_s, boot_age_s=self.silent_s + elapsed_s)
        if self.opened is None or elapsed_s < self.boot_after_s:
            return aged
        return replace(aged, boot_age_s=0.1, **self.boots(elapsed_s))

    def reopen(self, link: str, timeout_s: float) -> bool:
        self.opened = self.clock.mono()
        self.reopen_hook()
        return True

    def act(self, condition: str = "autopilot_silent") -> tuple[str, str]:
        """What the action reports that it did, and what else it reports as the cause."""
        result = Result(Level.ERROR, "silent", "silent", condition, "link:fc")
        fault = Fault("F1", "autopilot", Slot.AUTOPILOT, Layer.LINK, result, Stamp(0.0, 0.0))
        context = ActionContext(
            cast(Any, None),
            action_settings(settings()),
            lambda key: None,
            lambda: None,
            lambda key, net: None,
            reopen=self.reopen,
            link=self.link,
            autopilot=self.autopilot,
            clock=self.clock,
        )
        target, action = Target(TargetKind.LINK, "fc"), Reopen()
        return action.run(target, fault, context), action.other_cause(target, fault, context)


PILOT = AutopilotFact(10.0, False, link="fc", boot_s=500.0)


def test_an_autopilot_that_answers_immediately_was_behind_a_dead_connection() -> None:
    """Its time since boot is unknown, or continues as usual: it ran all the time, and only PHM's side of the link was
    stuck.
    """
    assert Cable().act() == ("reopened the MAVLink endpoint fc", "")
    assert Cable(pilot=PILOT).act()[1] == ""
    assert Cable(pilot=replace(PILOT, boot_s=None)).act()[1] == ""


def test_an_autopilot_that_answers_late_recovered_spontaneously() -> None:
    """It hung for longer than the reopening took."""
    assert "recovered by itself" in Cable(speaks_after_s=PROMPT_S + 1.0).act()[1]
    assert "recovered by itself" in Cable(speaks_after_s=PROMPT_S + 1.0).act("radio_silent")[1]


def test_a_rebooted_autopilot_was_not_recovered_by_the_action() -> None:
    """It answers immediately, and has been running for two seconds."""
    made = Cable(pilot=PILOT, boots=lambda elapsed_s: {"boot_s": 2.0, "reboots": 1})
    assert made.act()[1].startswith("the autopilot has rebooted, and has been running for 2 s")


def test_a_suspended_autopilot_was_not_recovered_by_the_action() -> None:
    """Its time since boot lacks those seconds: it was suspended and resumed."""
    made = Cable(pilot=PILOT, boots=lambda elapsed_s: {"boot_s": 500.0 + elapsed_s - BEHIND_S - 5.0})
    assert made.act()[1] == "the autopilot did not run for 7 s"


def test_the_time_since_boot_is_waited_for() -> None:
    """It arrives a moment after the first heartbeat. If it never does, nothing shows that the action helped: a real ArduPilot
    that hung for 12 s sent it 3.04 s after it resumed."""
    made = Cable(pilot=PILOT, boot_after_s=PROMPT_S, boots=lambda elapsed_s: {"boot_s": 1.0, "reboots": 1})
    assert "rebooted" in made.act()[1]
    never = Cable(pilot=PILOT, boot_after_s=1000.0)
    assert "has not reported its time since boot" in never.act()[1]
    assert never.clock.mono() - 1000.0 < PROMPT_S + 2 * BOOT_S


def test_a_reboot_without_a_time_since_boot_is_recognized() -> None:
    """By the state BOOT in its first heartbeat, which counts as a reboot."""
    made = Cable(pilot=replace(PILOT, boot_s=None))
    made.reopen_hook = lambda: setattr(made, "pilot", replace(PILOT, boot_s=None, reboots=1))
    assert made.act()[1] == "the autopilot has rebooted"


def test_another_links_autopilot_is_ignored() -> None:
    """Only the autopilot of the reopened link shows whether it has rebooted."""
    made = Cable(pilot=replace(PILOT, link="other"), boots=lambda elapsed_s: {"boot_s": 1.0, "reboots": 1})
    assert made.act()[1] == ""


def test_a_link_with_data_is_not_reopened() -> None:
    """Its connection would be cut, and it needs no recovery."""
    made = Cable(silent_s=0.2)
    said, _ = made.act()
    assert (said, made.opened) == ("data arrives by fc again", None)
    assert isinstance(said, NotNeeded)
