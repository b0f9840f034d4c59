"""A period much longer than the first guess is learned; outages are not."""

from __future__ import annotations

import pytest

from phm.swarm.peers import LOST_PERIODS, Peers
from phm.wire.tunnel import PeerState
from tests.swarm.test_core import HEALTHY, PERIOD_S


def test_outages_of_different_length_are_not_a_period() -> None:
    """At the edge of radio range, with one heartbeat in between: the next loss is detected as soon as the first."""
    peers = Peers(1, PERIOD_S)
    for at in (*range(0, 20, 2), 45, 80, 95, 140, 320, 500):
        peers.heartbeat(2, HEALTHY, float(at))
    assert peers.states(500.1 + LOST_PERIODS * PERIOD_S)[2] is PeerState.LOST


@pytest.mark.parametrize(("link", "delay_s"), [("mesh", 1.5), ("radio", 0.5)])
def test_a_long_period_is_learned_though_each_heartbeat_arrives_twice(link: str, delay_s: float) -> None:
    """By another link, or by a router on the same one."""
    peers = Peers(1, PERIOD_S)
    for at in range(0, 600, 40):
        peers.heartbeat(2, HEALTHY, float(at), link="radio")
        peers.heartbeat(2, HEALTHY, at + delay_s, link=link)
    assert peers.states(599.0)[2] is PeerState.ALIVE
