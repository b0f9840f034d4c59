"""Peers that fall silent together are reported lost sooner than a single one; neither chance nor a short fade counts."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from statistics import mean

import pytest

from phm.swarm.peers import LOST_PERIODS, Peers
from phm.wire.tunnel import PeerState

PERIOD_S = 2.0
STEP_S = 0.2
WORD = 5
LEARNED_S = 300.0
"""Long enough for heartbeats that arrived without loss to be known as steady."""
Received = Callable[[int, float], bool]


class Air:
    """Agents 2... send heartbeats with up to a tenth of a second of jitter, each at a different time; agent 1 receives."""

    def __init__(self, peers: int, seed: int, *, even: bool = False) -> None:
        self.random = random.Random(seed)
        self.others = range(2, 2 + peers)
        self.peers = Peers(1, PERIOD_S, self.others)
        self.now = 0.0
        self.receives: Received = lambda agent, now: True
        phases = [place / peers if even else self.random.random() for place in range(peers)]
        self._due = {agent: phase * PERIOD_S for agent, phase in zip(self.others, phases, strict=True)}
        self._late = dict.fromkeys(self.others, 0.0)

    def run(self, seconds: float, *, until: Callable[[], bool] = lambda: False) -> float:
        """Seconds until `until` is true, or `seconds`; polled every STEP_S."""
        began = self.now
        while self.now < began + seconds and not until():
            self.now += STEP_S
            for agent in self.others:
                while self._due[agent] + self._late[agent] <= self.now:
                    at = self._due[agent] + self._late[agent]
                    self._due[agent] += PERIOD_S
                    self._late[agent] = self.random.random() / 10
                    if self.receives(agent, at):
                        self.peers.heartbeat(agent, WORD, at)
            self.peers.watch(self.now, PERIOD_S)
        return self.now - began

    def lost(self) -> set[int]:
        return {agent for agent, seen in self.peers.states(self.now).items() if seen is PeerState.LOST}

    def cut(self, agents: Iterable[int]) -> float:
        """Seconds until all of these are lost; a random part of a period passes before the cut."""
        gone = set(agents)
        self.run(self.random.random() * PERIOD_S)
        self.receives = lambda agent, now: agent not in gone
        return self.run(30.0, until=lambda: gone <= self.lost())

    def lossy(self, share: float) -> None:
        self.receives = lambda agent, now: self.random.random() >= share


@pytest.mark.parametrize(
    ("peers", "cut", "even", "average_s", "most_s"),
    [(7, 7, True, 2.8, 3.0), (7, 7, False, 3.0, 3.8), (4, 4, True, 3.2, 3.6), (7, 4, True, 3.2, 3.6)],
)
def test_a_cut_is_detected_long_before_a_single_loss(
    peers: int, cut: int, even: bool, average_s: float, most_s: float
) -> None:
    """All peers, or more than half of them: two missed heartbeats of one and one each of the others are enough."""
    times = []
    for seed in range(8):
        air = Air(peers, seed, even=even)
        air.run(LEARNED_S)
        times.append(air.cut(list(air.others)[:cut]))
    assert mean(times) <= average_s
    assert max(times) <= most_s


@pytest.mark.parametrize("share", [0.05, 0.2])
@pytest.mark.parametrize("peers", [4, 7])
def test_random_loss_is_never_reported_as_a_cut(peers: int, share: float) -> None:
    """Two hours, a fifth of all heartbeats lost: no group loss is reported."""
    air = Air(peers, 1)
    air.lossy(share)
    air.run(7200.0, until=lambda: any(peer.lost_together for peer in air.peers.all().values()))
    assert air.now >= 7200.0


def test_a_cut_is_detected_on_a_lossy_network_too() -> None:
    """Never later than a single loss."""
    air = Air(7, 2)
    air.lossy(0.2)
    air.run(LEARNED_S)
    longest = max(peer.period_s for peer in air.peers.all().values())
    assert air.cut(air.others) <= LOST_PERIODS * max(longest, 1.5 * PERIOD_S)


@pytest.mark.parametrize("peers", [4, 7])
def test_a_fade_of_one_period_is_not_a_loss(peers: int) -> None:
    """This agent's own radio receives nothing for 2 s, a hundred times, without learning from earlier fades."""
    air = Air(peers, 3)
    air.run(LEARNED_S)
    for _ in range(100):
        air.peers._fades.clear()
        end = air.now + PERIOD_S
        air.receives = lambda agent, now, end=end: now > end  # type: ignore[misc]
        air.run(10.0 + air.random.random() * PERIOD_S, until=lambda: bool(air.lost()))
        assert air.lost() == set()


def test_a_loss_must_exceed_earlier_fades() -> None:
    """A fade of 3 s is reported, the next ones of that length are not; ten minutes later it is forgotten."""
    reported = []
    air = Air(7, 4, even=True)
    for pause_s in (LEARNED_S, 30.0, 30.0, 630.0):
        air.run(pause_s)
        end = air.now + 3.2
        air.receives = lambda agent, now, end=end: now > end  # type: ignore[misc]
        reported.append(air.run(8.0, until=lambda: bool(air.lost())) < 8.0)
        air.receives = lambda agent, now: True
    assert reported == [True, False, False, True]


def test_synchronized_agents_are_not_lost_by_one_missed_heartbeat() -> None:
    """All send at the same moment, and a collision or a fade drops one of each."""
    air = Air(7, 5)
    air._due = dict.fromkeys(air.others, 1.0)
    air.run(LEARNED_S)
    air.receives = lambda agent, now: not LEARNED_S < now <= LEARNED_S + PERIOD_S
    air.run(20.0, until=lambda: bool(air.lost()))
    assert air.lost() == set()


def test_our_own_pause_is_not_a_loss() -> None:
    """PHM is suspended for 5 s, and the heartbeats of that time are lost."""
    air = Air(7, 6)
    air.run(LEARNED_S)
    stall = air.now + 5.0
    air.receives = lambda agent, now: now > stall
    air.now = stall
    air.run(10.0, until=lambda: bool(air.lost()))
    assert air.lost() == set()
    assert air.now > stall + 9.0


def test_no_agent_is_lost_early_when_a_link_is_closed() -> None:
    """Its own check reports it; after five periods the agents are lost all the same."""
    air = Air(7, 7)
    air.run(LEARNED_S)
    for _ in range(20):
        air.now += STEP_S
        air.peers.watch(air.now, PERIOD_S, receives=False)
    assert air.lost() == set()


def test_no_agent_is_lost_when_a_growing_swarm_slows_its_heartbeats() -> None:
    """The new, longer period counts immediately."""
    air = Air(7, 8)
    air.run(LEARNED_S)
    last_received = max(peer.received_s or 0.0 for peer in air.peers.all().values())
    while air.now < last_received + 5.0:
        air.now += STEP_S
        air.peers.watch(air.now, 5.0)
        assert air.lost() == set()


def test_one_steady_peer_is_lost_after_three_missed_heartbeats() -> None:
    """Sooner than the five periods of a peer that was not received for long, or not steadily."""
    steady, new, lossy = (Air(7, 9) for _ in range(3))
    steady.run(LEARNED_S)
    new.run(40.0)
    lossy.receives = lambda agent, now: agent != 2 or now % 60.0 > 4.5
    lossy.run(LEARNED_S)
    lossy.receives = lambda agent, now: True
    lossy.run(20.0)
    first, second, third = (air.cut([2]) for air in (steady, new, lossy))
    assert first < 3.3 * PERIOD_S < second <= (LOST_PERIODS + 0.5) * PERIOD_S
    assert third > first + 0.5 * PERIOD_S


def test_agents_that_fall_silent_one_after_another_have_not_vanished_together() -> None:
    """The second one is not lost before its own time."""
    air = Air(7, 10)
    air.run(LEARNED_S)
    air.receives = lambda agent, now: agent != 2
    air.run(2.5 * PERIOD_S)
    air.receives = lambda agent, now: agent not in (2, 3)
    air.run(1.5 * PERIOD_S, until=lambda: 3 in air.lost())
    assert air.lost() == {2}


@pytest.mark.parametrize("delays", [(0.0,), (0.0, 0.9), (0.0, 0.6, 1.2)])
def test_two_missed_heartbeats_of_two_peers_are_no_loss_by_any_number_of_links(delays: tuple[float, ...]) -> None:
    """A radio delivers each heartbeat again, later than Wi-Fi. With gaps between links for periods, this would be a split."""
    peers = Peers(1, PERIOD_S, range(1, 7))
    for step in range(1000):
        beat, place = divmod(step, 10)
        for link, delay_s in enumerate(delays):
            for agent in range(2, 7):
                if place == round(delay_s / STEP_S) and not (agent < 4 and beat in (60, 61)):
                    peers.heartbeat(agent, WORD, step * STEP_S, link=f"link_{link}")
        peers.watch(step * STEP_S, PERIOD_S)
        assert PeerState.LOST not in peers.states(step * STEP_S).values()


def test_two_agents_with_one_id_are_never_lost_between_their_heartbeats() -> None:
    """Their heartbeats arrive in pairs, unlike those of one agent."""
    peers = Peers(1, PERIOD_S, (2, 3, 4))
    for step in range(2000):
        now = step / 5
        for agent in (2, 3, 4):
            if step % 10 in (agent, agent + 2):
                peers.heartbeat(agent, WORD, now)
        peers.watch(now, PERIOD_S)
        assert PeerState.LOST not in peers.states(now).values()


def test_a_peer_that_is_received_again_is_back() -> None:
    """Within little more than a period."""
    air = Air(7, 11)
    air.run(LEARNED_S)
    air.cut(air.others)
    air.receives = lambda agent, now: True
    air.run(1.2 * PERIOD_S, until=lambda: not air.lost())
    assert air.lost() == set()
