"""An application that ends because a file is missing: the file comes before the next start, and delays no start."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from phm.core.model import Fault, Phase
from phm.core.settings import RecoverySettings
from phm.recovery.base import ActionContext
from phm.recovery.fault_cases import AttemptRecord, History
from phm.recovery.policy import Act
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of
from tests.recovery.test_policy import fault, say

UNITS = {"container/app": Of("app"), "files/app": Of("app")}
Start = Callable[[], Agent]


@pytest.fixture
def start() -> Iterator[Start]:
    made: list[Agent] = []

    def begin() -> Agent:
        actions, ladders = ("start", "restart", "restore_file"), {"exited": ["start", "restart"]}
        agent = Agent(UNITS, Containers("app"), FakeClock(), actions=actions, ladders=ladders)
        made.append(agent)
        missing = {"files/app"}

        def act(key: str, context: ActionContext, fault: Fault) -> None:
            if fault.unit in missing:
                missing.clear()
                del agent.bad["files/app"]
                return
            agent.containers.start(key)
            agent.pipeline.container_started(key)
            if missing:
                agent.containers.end(key)
            else:
                del agent.bad["container/app"]

        agent.behave = act
        agent.rest(3.0)
        return agent

    yield begin
    for agent in made:
        agent.stop()
        agent.clock.advance(1000)


@pytest.mark.parametrize("before_s", [0.0, 1.0])
def test_a_file_is_restored_before_the_next_start(start: Start, before_s: float) -> None:
    """PHM does not give up on a container while it has a copy of the file that the container needs."""
    agent = start()
    agent.containers.end("app")
    agent.bad["container/app"] = "exited"
    agent.rest(before_s)
    agent.bad["files/app"] = "file_missing"
    agent.rest(30.0)
    assert agent.acted() == ["start", "restore_file", "restart"]
    assert Phase.ESCALATED not in agent.steps()
    assert not agent.pipeline.open_faults()


def test_the_pause_between_starts_is_not_counted_from_a_restored_file() -> None:
    """Nothing was started then."""
    made = [(900.0, "start"), (903.0, "restart"), (906.0, "restart"), (950.0, "restore_file"), (955.0, "relaunch")]
    history = History([AttemptRecord(at, "health/app", "exited", action, False) for at, action in made])
    ready = 906.0 + RecoverySettings().backoff_max
    assert say(history, fault=fault("exited"), now=ready - 1.0, given_up=True) != Act("start", 6, alone=True)
    assert say(history, fault=fault("exited"), now=ready, given_up=True) == Act("start", 6, alone=True)
