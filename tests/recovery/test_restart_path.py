"""One restart, from the fault to its verification, stays readable in one sitting: the files that it crosses."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, cast

from phm import testing
from phm.core.model import Phase
from phm.recovery.actions.restart import Restart
from phm.recovery.base import Action
from tests.recovery.simulated_agent import Agent, Containers, Of

PATH = {
    "executor": "gives the fault to the worker of its container",
    "worker": "the thread of the container: decides, acts, looks again",
    "fault_cases": "what is known about the container: its open faults, and what was tried",
    "policy": "decides: restart",
    "attempt": "locks the container, acts, has it verified, and releases it",
    "ownership": "who acts on the container, and who started it",
    "base": "what an action is and acts on",
    "actions.restart": "acts",
    "verification": "verifies by check runs",
}
"""The modules of phm.recovery that one restart enters, in reading order, and what each does for it."""


class RestartingAgent(Agent):
    """An agent with the real action `restart`, and an engine that restarts its containers."""

    def _action(self, of: str) -> type[Action]:
        cast(Any, self.engine).restart = lambda ref, stop_timeout_s: self.containers.start("app")
        return Restart


class Crossed:
    """The modules of phm.recovery whose functions are called while `counting`, in the order of their first call."""

    def __init__(self) -> None:
        self.modules: dict[str, None] = {}
        self.counting = False

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        name = frame.f_globals.get("__name__", "")
        if self.counting and event == "call" and name.startswith("phm.recovery."):
            self.modules[name.removeprefix("phm.recovery.")] = None


@contextmanager
def profiled() -> Iterator[Crossed]:
    """In all threads that are started inside."""
    crossed, before = Crossed(), sys.getprofile()
    threading.setprofile(crossed)
    sys.setprofile(crossed)
    try:
        yield crossed
    finally:
        sys.setprofile(before)
        threading.setprofile(cast(Any, None))


def test_one_restart_crosses_nine_files_at_most() -> None:
    """Fault opened, decided, acted, verified, released. Nothing is on hold, approved, requested or flight-critical."""
    with profiled() as crossed:
        containers = Containers("app")
        agent = RestartingAgent({"container/app": Of("app")}, containers, testing.FakeClock())
        agent.observe()
        crossed.counting = True
        agent.bad["container/app"] = "broken"
        agent.until(lambda: containers.facts["app"].started_at == "start 1", "the restart")
        agent.bad.clear()
        agent.until(lambda: agent.closed(), "the end of the fault")
        agent.step()
        crossed.counting = False
        agent.stop()
    assert agent.steps() == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    assert agent.acted(Phase.VERIFIED) == ["restart"]
    assert sorted(crossed.modules) == sorted(PATH)
    assert len(crossed.modules) <= 9
