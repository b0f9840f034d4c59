"""An agent that announced its shutdown, and one that is back after it."""

from __future__ import annotations

from phm.swarm.consensus import MemberState
from tests.swarm.test_core import HEALTHY, PERIOD_S, Swarm


def shut_down(swarm: Swarm, *hearers: int) -> None:
    """Agent 3 announces it; these agents receive that."""
    for hearer in hearers:
        swarm.peers[hearer].heartbeat(3, HEALTHY, swarm.now, leaving=True)


def test_an_agent_that_is_back_for_others_has_not_left() -> None:
    """It was started again, and A01 does not receive it any more."""
    swarm = Swarm(range(1, 5))
    swarm.run(20)
    shut_down(swarm, 1, 2, 4)
    swarm.cut = {(3, 1)}
    swarm.run(20)
    status = swarm.agreed(1).statuses[3]
    assert (status.state, status.received_by) == (MemberState.PARTLY, (2, 4))


def test_an_agent_has_left_though_another_one_has_not_received_the_announcement() -> None:
    """That one waits for its heartbeats for a while, and reports meanwhile that it receives it."""
    swarm = Swarm(range(1, 5))
    swarm.run(20)
    shut_down(swarm, 1, 4)
    swarm.down = {3}
    for _ in range(20):
        swarm.run(PERIOD_S)
        assert swarm.agreed(1).statuses[3].state in (MemberState.ALIVE, MemberState.LEFT)
    assert swarm.agreed(1).statuses[3].state is MemberState.LEFT
