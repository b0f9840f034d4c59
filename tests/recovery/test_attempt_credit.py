"""What a fault is said to have been resolved by: an action only where the evidence supports it."""

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
from phm.recovery.base import ActionContext, NotNeeded
from phm.recovery.target import Target, TargetKind
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
    """By what, and the words about the action."""
    agent.rest(3.0)
    agent.behave = behave
    agent.bad["health/app"] = "broken"
    agent.until(agent.closed, "the end of the fault")
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the word about the action")
    said = [event.detail for event in agent.of(ActionEvent) if event.phase is Phase.VERIFIED]
    return agent.closed()[0].fault.by, said[0]


def test_an_action_that_helped_is_named(agent: Agent) -> None:
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "restart"
    assert "not because of" not in said


def test_an_action_that_found_nothing_to_do_is_not_named(agent: Agent) -> None:
    """An operator was quicker: the container ran, the file was there."""

    def nothing(key: str, context: ActionContext, fault: Fault) -> NotNeeded:
        agent.bad.clear()
        return NotNeeded("app is already running")

    by, said = resolved(agent, nothing)
    assert by == "itself"
    assert said.endswith("but not because of restart: there was nothing to do")


def test_an_action_may_know_what_else_has_helped(agent: Agent) -> None:
    agent.other_cause = lambda: "the moon has moved"
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "itself"
    assert said.endswith("but not because of restart: the moon has moved")


def test_a_recovery_is_credited_when_no_thread_can_be_started_to_ask(
    agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a limit of processes nothing speaks against the action."""
    begin = threading.Thread.start

    def start(thread: threading.Thread) -> None:
        if thread.name.startswith("phm-credit"):
            raise RuntimeError("can't start new thread")
        begin(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    by, said = resolved(agent, lambda key, context, fault: agent.bad.clear())
    assert by == "restart"
    assert "not because of" not in said


# ---------------------------------------------------------------- a link


class Running(testing.FakeClock):
    """Goes on while somebody waits."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.advance(timeout_s or 0.0)
        return event.is_set()


@dataclass
class Cable:
    """A link that is silent for `silent_s`. `speaks_after_s`: something comes so long after it was opened again."""

    speaks_after_s: float = 0.3
    silent_s: float = 10.0
    pilot: AutopilotFact | None = None
    boot_after_s: float = 0.5
    """After so long the autopilot has reported a time since boot again."""
    boots: Callable[[float], dict[str, Any]] = lambda elapsed_s: {}
    """What is new about it then, by how long ago the action began."""
    clock: Running = field(default_factory=Running)
    opened: float | None = None
    began: float = 1000.0

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
        return True

    def act(self, condition: str = "autopilot_silent") -> tuple[str, str]:
        """What the action says it did, and what else it says has helped."""
        result = Result(Level.ERROR, "silent", "silent", condition, "link:fc")
        fault = Fault("F1", "autopilot", Slot.AUTOPILOT, Layer.LINK, result, Stamp(0.0, 0.0))
        context = ActionContext(
            cast(Any, None),
            settings(),
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


def test_what_answers_as_soon_as_it_is_opened_was_behind_a_dead_connection() -> None:
    """Nobody knows its time since boot, or that goes on as usual: it ran all the time, and only PHM's end was stuck."""
    assert Cable().act() == ("reopened the MAVLink endpoint fc", "")
    assert Cable(pilot=PILOT).act()[1] == ""
    assert Cable(pilot=replace(PILOT, boot_s=None)).act()[1] == ""


def test_what_answers_late_has_come_back_by_itself() -> None:
    """It hung for longer than the opening took."""
    assert "recovered by itself" in Cable(speaks_after_s=PROMPT_S + 1.0).act()[1]
    assert "recovered by itself" in Cable(speaks_after_s=PROMPT_S + 1.0).act("radio_silent")[1]


def test_an_autopilot_that_has_rebooted_was_not_helped() -> None:
    """It answers at once, and has been running for two seconds."""
    made = Cable(pilot=PILOT, boots=lambda elapsed_s: {"boot_s": 2.0, "reboots": 1})
    assert made.act()[1].startswith("the autopilot has rebooted, and has been running for 2 s")


def test_an_autopilot_that_did_not_run_meanwhile_was_not_helped() -> None:
    """Its time since boot has lost those seconds: it stood, and goes on."""
    made = Cable(pilot=PILOT, boots=lambda elapsed_s: {"boot_s": 500.0 + elapsed_s - BEHIND_S - 5.0})
    assert made.act()[1] == "the autopilot did not run for 7 s"


def test_the_time_since_boot_is_waited_for() -> None:
    """It comes a moment after the first heartbeat, or never."""
    made = Cable(pilot=PILOT, boot_after_s=PROMPT_S, boots=lambda elapsed_s: {"boot_s": 1.0, "reboots": 1})
    assert "rebooted" in made.act()[1]
    never = Cable(pilot=PILOT, boot_after_s=1000.0)
    assert never.act()[1] == ""
    assert never.clock.mono() - 1000.0 < PROMPT_S + 2 * BOOT_S


def test_another_links_autopilot_says_nothing_about_this_one() -> None:
    made = Cable(pilot=replace(PILOT, link="other"), boots=lambda elapsed_s: {"boot_s": 1.0, "reboots": 1})
    assert made.act()[1] == ""


def test_a_link_by_which_something_comes_again_is_not_opened_again() -> None:
    """What it carries would be cut, and it needs no help."""
    made = Cable(silent_s=0.2)
    said, _ = made.act()
    assert (said, made.opened) == ("data arrives by fc again", None)
    assert isinstance(said, NotNeeded)
