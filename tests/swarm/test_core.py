"""Peers, consensus, election and digest, with simulated agents on one clock."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given, settings, strategies as st

from phm.core.model import Level, Slot
from phm.swarm import digest
from phm.swarm.agent_count import SmoothedAgentCount
from phm.swarm.consensus import Consensus, MemberState, MemberStatus, compute_consensus, without_gcs
from phm.swarm.leader_election import STEADY_S, VIEWS_S, LeaderElection
from phm.swarm.peers import LATE_PERIODS, LOST_PERIODS, Peers
from phm.wire import status_word
from phm.wire.tunnel import PeerState, PeerView

HEALTHY = status_word.encode(dict.fromkeys(list(Slot)[:8], Level.OK))
PERIOD_S = 2.0


class Swarm:
    """Agents that receive each other except for the pairs in `cut`; each sends a heartbeat and a view per period."""

    def __init__(self, agents: Iterable[int], gcs: Iterable[int] | None = None) -> None:
        self.agents = list(agents)
        self.gcs = set(self.agents if gcs is None else gcs)
        self.peers = {agent: Peers(agent, PERIOD_S, self.agents) for agent in self.agents}
        self.down: set[int] = set()
        self.cut: set[tuple[int, int]] = set()
        self.words = dict.fromkeys(self.agents, HEALTHY)
        self.now, self.sequence = 0.0, 0

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.sequence += 1
            for sender in self.agents:
                if sender not in self.down:
                    self._send(sender)
            self.now += PERIOD_S

    def _send(self, sender: int) -> None:
        view = PeerView(self.sequence % 256, sender in self.gcs, True, True, self.peers[sender].states(self.now))
        for hearer in self.agents:
            if hearer not in self.down and hearer != sender and (sender, hearer) not in self.cut:
                self.peers[hearer].heartbeat(sender, self.words[sender], self.now)
                self.peers[hearer].add_view(sender, view, self.now)

    def separate(self, one: Iterable[int], other: Iterable[int]) -> None:
        self.cut |= {pair for a in one for b in other for pair in ((a, b), (b, a))}

    def agreed(self, by: int) -> Consensus:
        return compute_consensus(self.peers[by], self.now)


def test_all_agents_agree_that_all_are_alive() -> None:
    """Without faults, each has the same view."""
    swarm = Swarm(range(1, 9))
    swarm.run(20)
    for agent in swarm.agents:
        assert {status.state for status in swarm.agreed(agent).statuses.values()} == {MemberState.ALIVE}
        assert swarm.agreed(agent).living == tuple(swarm.agents)


def test_a_dead_agent_is_lost_for_all() -> None:
    """Within LOST_PERIODS and two periods more; it remains a member, and nothing is a split."""
    swarm = Swarm(range(1, 9))
    swarm.run(20)
    swarm.down = {3}
    swarm.run(LOST_PERIODS * PERIOD_S + 2 * PERIOD_S)
    for agent in set(swarm.agents) - {3}:
        agreed = swarm.agreed(agent)
        assert agreed.lost == (3,)
        assert agreed.split == ()
        assert agreed.members == 8


def test_one_agent_without_reception_does_not_make_a_peer_lost() -> None:
    """The agent without a GCS learns from the others that the peer is alive."""
    swarm = Swarm(range(1, 6))
    swarm.run(20)
    swarm.cut = {(3, 1)}
    swarm.run(20)
    assert swarm.peers[1].states(swarm.now)[3] is PeerState.LOST
    for agent in (1, 2, 4, 5):
        status = swarm.agreed(agent).statuses[3]
        assert status.state is MemberState.PARTLY
        assert status.not_received_by == (1,)
        assert status.received_by == tuple({2, 4, 5})


def test_a_peer_that_most_agents_lost_is_lost_and_disagreement_is_shown() -> None:
    """`received_by` names those that still receive it."""
    swarm = Swarm(range(1, 7))
    swarm.run(20)
    swarm.cut = {(3, hearer) for hearer in (1, 2, 4, 6)}
    swarm.run(20)
    status = swarm.agreed(1).statuses[3]
    assert (status.state, status.received_by) == (MemberState.LOST, (5,))


def test_a_split_network_is_reported_on_both_sides_and_recovers() -> None:
    """Each side names the other; afterwards no agent is lost."""
    swarm = Swarm(range(1, 9))
    swarm.run(20)
    swarm.separate((1, 2, 3), (4, 5, 6, 7, 8))
    swarm.run(30)
    assert swarm.agreed(1).split == (4, 5, 6, 7, 8)
    assert swarm.agreed(8).split == (1, 2, 3)
    swarm.cut.clear()
    swarm.run(10)
    assert swarm.agreed(1).lost == swarm.agreed(8).lost == ()


def test_a_received_peer_did_not_vanish() -> None:
    """A split ends, and the other half receives one of our agents; its views still report the rest of us as lost, which
    does not convince an agent that receives them.
    """
    swarm = Swarm(range(1, 9))
    swarm.run(20)
    swarm.separate((1, 2, 3), (4, 5, 6, 7, 8))
    swarm.run(30)
    swarm.cut = {(a, b) for a, b in swarm.cut if a < 4 and a != 1}
    swarm.run(PERIOD_S)
    agreed = swarm.agreed(1)
    assert agreed.lost == ()
    assert {agreed.statuses[agent].state for agent in (2, 3)} == {MemberState.PARTLY}
    assert agreed.split == ()


def test_agents_that_die_one_after_another_are_not_a_split() -> None:
    """A split needs a loss at one time."""
    swarm = Swarm(range(1, 6))
    swarm.run(20)
    swarm.down = {4}
    swarm.run(40)
    swarm.down = {4, 5}
    swarm.run(40)
    assert swarm.agreed(1).lost == (4, 5)
    assert swarm.agreed(1).split == ()


def test_the_first_loss_is_late_before_it_is_lost() -> None:
    """LATE after LATE_PERIODS, LOST after LOST_PERIODS."""
    peers = Peers(1, PERIOD_S)
    for at in range(0, 20, 2):
        peers.heartbeat(2, HEALTHY, at)
    assert peers.states(18 + LATE_PERIODS * PERIOD_S)[2] is PeerState.ALIVE
    assert peers.states(18.1 + LATE_PERIODS * PERIOD_S)[2] is PeerState.LATE
    assert peers.states(18.1 + LOST_PERIODS * PERIOD_S)[2] is PeerState.LOST


@pytest.mark.parametrize("period_s", [10, 15, 40])
def test_a_slower_peer_is_not_late(period_s: int) -> None:
    """It sends less often than we do, every 2 s: its period is learned from its own gaps."""
    peers = Peers(1, 2.0)
    for at in range(0, 600, period_s):
        peers.heartbeat(2, HEALTHY, float(at))
    assert peers.states(599.0)[2] is PeerState.ALIVE


@pytest.mark.parametrize("delays", [(0.0,), (0.0, 0.9), (0.0, 0.6, 1.2)])
def test_a_peer_received_by_several_links_keeps_its_period(delays: tuple[float, ...]) -> None:
    """Each link delivers its heartbeats with another delay, so the gaps between links are shorter than its period."""
    peers = Peers(1, PERIOD_S)
    for beat in range(60):
        for link, delay_s in enumerate(delays):
            last_s = PERIOD_S * beat + delay_s
            peers.heartbeat(2, HEALTHY, last_s, link=f"link_{link}")
    assert peers.states(last_s + LATE_PERIODS * PERIOD_S - 0.1)[2] is PeerState.ALIVE
    assert peers.states(last_s + LOST_PERIODS * PERIOD_S - 0.1)[2] is PeerState.LATE
    assert peers.states(last_s + LOST_PERIODS * PERIOD_S + 0.1)[2] is PeerState.LOST


@pytest.mark.parametrize("broken", ["mesh", "radio"])
def test_the_outage_of_one_link_is_not_a_longer_period(broken: str) -> None:
    """The other link delivers the heartbeats meanwhile."""
    peers = Peers(1, PERIOD_S)
    for beat in range(200):
        for link, delay_s in (("mesh", 0.0), ("radio", 0.5)):
            if link != broken or not 50 <= beat < 150:
                peers.heartbeat(2, HEALTHY, PERIOD_S * beat + delay_s, link=link)
        assert peers.states(PERIOD_S * beat + 0.5)[2] is PeerState.ALIVE
        peer = peers.peer(2)
        assert peer is not None and peer.period_s == pytest.approx(PERIOD_S)


def test_an_agent_stopped_on_purpose_has_left() -> None:
    """It announced its end, so it is no longer a member and not lost."""
    swarm = Swarm(range(1, 4))
    swarm.run(20)
    for hearer in (1, 2):
        swarm.peers[hearer].heartbeat(3, HEALTHY, swarm.now, leaving=True)
    swarm.down = {3}
    swarm.run(20)
    assert swarm.agreed(1).statuses[3].state is MemberState.LEFT
    assert swarm.agreed(1).members == 2


def test_an_unlisted_agent_has_no_vote() -> None:
    """It is named as unlisted while it is received; where no agents are listed it is a regular member."""
    listed, open_ = Peers(1, PERIOD_S, [1, 2, 3]), Peers(1, PERIOD_S)
    for peers in (listed, open_):
        for at in range(0, 20, 2):
            peers.heartbeat(2, HEALTHY, float(at), frame=at)
            peers.heartbeat(77, HEALTHY, float(at), frame=at)
            peers.add_view(77, PeerView(at, True, True, True, {2: PeerState.LOST}), float(at))
    assert listed.states(20.0) == {2: PeerState.ALIVE, 3: PeerState.NEVER}
    assert (listed.unlisted(20.0), listed.agents_on_links(20.0)) == ((77,), 3)
    assert (open_.unlisted(20.0), open_.agents_on_links(20.0)) == ((), 3)
    assert open_.states(60.0) == {2: PeerState.LOST, 77: PeerState.LOST}
    assert listed.unlisted(200.0) == ()


def test_a_list_of_only_this_agent_is_respected() -> None:
    """It flies alone, and no other agent may join it."""
    peers = Peers(1, PERIOD_S, [1])
    peers.heartbeat(2, HEALTHY, 0.0, frame=1)
    assert (peers.states(0.0), peers.agents_on_links(0.0), peers.unlisted(0.0)) == ({}, 1, (2,))


def test_a_received_agent_is_not_lost_by_votes_of_others() -> None:
    """However many observers report it lost; for an agent that does not receive it, the majority counts as usual."""
    swarm = Swarm(range(1, 7))
    swarm.run(20)
    swarm.cut = {(3, hearer) for hearer in (1, 2, 4, 6)}
    swarm.run(20)
    assert swarm.agreed(5).statuses[3].state is MemberState.PARTLY
    assert swarm.agreed(1).statuses[3].state is MemberState.LOST


def test_a_long_pause_does_not_break_the_agent_count() -> None:
    """PHM was frozen for days: the first look afterwards failed, and so did each later one."""
    assert SmoothedAgentCount(8, 0.0).update(8, 1e6) == 8
    assert SmoothedAgentCount(8, 0.0).update(2, 1e6) == 2


def test_the_budget_share_changes_slowly_and_returns() -> None:
    """A burst of invented senders has no effect, a lasting flood halves the share every minute at most, and its end
    restores it.
    """
    share = SmoothedAgentCount(1, 0.0)
    assert [share.update(count, float(at)) for at, count in enumerate((1, 8, 3))] == [1, 8, 7]
    share, now = SmoothedAgentCount(3, 0.0), 0.0
    while now < 60.0:
        now += 0.5
        assert share.update(250, now) <= 16
    assert share.update(250, 300.0) == 250
    assert share.update(3, 360.0) == 125
    assert share.update(3, 3600.0) == 3
    peers = Peers(1, PERIOD_S)
    for agent in range(2, 250):
        peers.heartbeat(agent, HEALTHY, 0.0, frame=1)
    assert peers.agents_on_links(1.0) == 1


def test_a_member_that_was_never_received_is_never_seen() -> None:
    """It is not lost."""
    swarm = Swarm(range(1, 5))
    swarm.down = {4}
    swarm.run(20)
    assert swarm.agreed(1).statuses[4].state is MemberState.NEVER


def test_a_duplicate_id_is_detected_and_a_restart_is_not() -> None:
    """Two senders count their frames separately; a restart resets the count once; loss and reordering never do."""
    peers = Peers(1, PERIOD_S)
    for at, frame in enumerate((250, 252, 5, 4, 60, 61, 0, 1, 2)):  # lost, reordered, restarted at 0
        peers.heartbeat(2, HEALTHY, 2.0 * at, frame=frame)
    assert peers.duplicate_ids(18.0) == ()
    for turn in range(4):
        peers.heartbeat(2, HEALTHY, 20.0 + turn, frame=10 + turn)
        peers.heartbeat(2, HEALTHY, 20.5 + turn, frame=90 + turn)
    assert peers.duplicate_ids(24.0) == (2,)
    assert peers.duplicate_ids(24.0 + 61 * PERIOD_S) == ()


@pytest.mark.parametrize("lived", [20, 70, 130, 200])
def test_restarts_are_not_a_duplicate_id(lived: int) -> None:
    """Three within a minute, each soon after the one before: a crash loop, or a power loss after a restart."""
    peers = Peers(1, PERIOD_S)
    for turn in range(40):
        peers.heartbeat(
            2, HEALTHY | (turn % 2) << 16, 1.5 * turn, frame=(lived + turn if turn < 10 else 3 * (turn % 10)) % 256
        )
        assert peers.duplicate_ids(1.5 * turn) == ()


@pytest.mark.parametrize("apart", [9, 20, 32, 33, 100, 200, 247])
def test_duplicates_are_detected_however_far_apart_they_count(apart: int) -> None:
    """One was started after the other."""
    peers = Peers(1, PERIOD_S)
    for turn in range(8):
        peers.heartbeat(2, HEALTHY, 2.0 * turn, frame=(apart + 2 * turn) % 256)
        peers.heartbeat(2, HEALTHY, 2.0 * turn + 1.0, frame=2 * turn)
    assert peers.duplicate_ids(16.0) == (2,)


@pytest.mark.parametrize("behind", [0, 1, 5, 8])
def test_duplicates_that_were_started_together_are_detected(behind: int) -> None:
    """Their sequence numbers are always close, and their status words equal except in one of them."""
    peers = Peers(1, PERIOD_S)
    for turn in range(12):
        peers.heartbeat(2, HEALTHY, 2.0 * turn, frame=turn + behind)
        peers.heartbeat(2, HEALTHY | 3 << 16, 2.0 * turn + 1.0, frame=turn)
    assert peers.duplicate_ids(24.0) == (2,)


def test_duplicates_with_equal_heartbeats_are_detected_by_other_messages() -> None:
    """Each sends a line now and then; a heartbeat with the number of such a line was not received before."""
    peers = Peers(1, PERIOD_S)
    first, second = 4, 0
    for turn in range(30):
        first, second = first + 1 + (turn % 5 == 0), second + 1 + (turn % 5 == 2)
        peers.heartbeat(2, HEALTHY, 2.0 * turn, frame=first % 256)
        peers.heartbeat(2, HEALTHY, 2.0 * turn + 1.0, frame=second % 256)
    assert peers.duplicate_ids(60.0) == (2,)


def test_a_late_copy_is_not_a_duplicate_id() -> None:
    """The same heartbeats once more, three heartbeats later, by the same link."""
    peers = Peers(1, PERIOD_S)
    for turn in range(100):
        peers.heartbeat(2, HEALTHY, 2.0 * turn, frame=turn % 256)
        if turn >= 3:
            peers.heartbeat(2, HEALTHY, 2.0 * turn + 1.0, frame=(turn - 3) % 256)
        assert peers.duplicate_ids(2.0 * turn) == ()


def test_the_same_frame_by_two_links_is_not_a_duplicate_id() -> None:
    """Routers forward a frame on several links, each with its own delay."""
    peers = Peers(1, PERIOD_S)
    for frame in range(200):
        peers.heartbeat(2, HEALTHY, 2.0 * frame, frame=frame, link="radio")
        peers.heartbeat(2, HEALTHY, 2.0 * frame, frame=max(0, frame - 40), link="mesh")
    assert peers.duplicate_ids(400.0) == ()


def test_our_own_frames_are_not_a_peer() -> None:
    """A router may send them back."""
    peers = Peers(7, PERIOD_S)
    assert not peers.heartbeat(7, HEALTHY, 0.0)
    assert not peers.add_view(7, PeerView(0, True, True, True), 0.0)
    assert peers.states(0.0) == {}


def test_an_agent_without_its_ground_radio_is_named() -> None:
    """By the others and by itself."""
    swarm = Swarm(range(1, 5), gcs=(1, 2, 4))
    swarm.run(20)
    assert without_gcs(swarm.agreed(1), own_gcs=True) == (3,)
    assert without_gcs(swarm.agreed(3), own_gcs=False) == (3,)


def test_a_ground_station_that_all_have_lost_is_not_a_radio_failure() -> None:
    """No agent is named."""
    swarm = Swarm(range(1, 5), gcs=())
    swarm.run(20)
    assert without_gcs(swarm.agreed(1), own_gcs=False) == ()


# ------------------------------------------------------------ election


def consensus(fit: dict[int, bool], own: int = 5) -> Consensus:
    return Consensus(
        own, {agent: MemberStatus(MemberState.ALIVE, gcs=gcs) for agent, gcs in fit.items() if agent != own}
    )


def test_the_lowest_agent_that_receives_the_ground_leads() -> None:
    """As soon as the views of all have arrived. If none receives it, there is no leader."""
    election, found = LeaderElection(), consensus({1: False, 2: True, 3: True})
    assert [election.leader(found, True, at) for at in (0.0, VIEWS_S - 0.1, VIEWS_S)] == [None, None, 2]
    assert LeaderElection().leader(consensus({1: False}), False, 0.0) is None


def test_a_better_leader_waits_until_it_is_stable() -> None:
    """It must receive the ground for STEADY_S without interruption."""
    election = LeaderElection()
    election.leader(consensus({3: True}), True, -VIEWS_S)
    assert election.leader(consensus({3: True}), True, 0.0) == 3
    for at in range(int(STEADY_S)):
        assert election.leader(consensus({1: at % 2 == 0, 3: True}), True, float(at)) == 3
    assert election.leader(consensus({1: True, 3: True}), True, 20.0) == 3
    assert election.leader(consensus({1: True, 3: True}), True, 20.0 + STEADY_S) == 1


def test_a_dead_leader_is_replaced_immediately() -> None:
    """The next agent leads as soon as the leader is lost, also one that has received the ground for a moment only."""
    election = LeaderElection()
    assert [election.leader(consensus({1: True, 2: False}), False, at) for at in (0.0, VIEWS_S)] == [None, 1]
    assert election.leader(consensus({2: True}), True, VIEWS_S + 1.0) == 2


@settings(max_examples=60, deadline=None)
@given(st.sets(st.integers(1, 20), min_size=1, max_size=12), st.data())
def test_all_elect_the_same_once_views_have_settled(agents: set[int], data: st.DataObject) -> None:
    """Whichever agents are down or receive the ground: in a connected network all live agents elect one leader. The last of three
    or more receives no other one, and elects none."""
    down = data.draw(st.sets(st.sampled_from(sorted(agents))))
    gcs = data.draw(st.sets(st.sampled_from(sorted(agents))))
    swarm = Swarm(sorted(agents), gcs)
    swarm.down = down
    elections = {agent: LeaderElection() for agent in agents}
    chosen = {}
    for _ in range(30):
        swarm.run(PERIOD_S)
        chosen = {a: elections[a].leader(swarm.agreed(a), a in gcs, swarm.now) for a in agents - down}
    alone = len(agents) > 2 and len(agents - down) == 1
    expected = None if alone else min((agents - down) & gcs, default=None)
    assert set(chosen.values()) <= {expected}


# ------------------------------------------------------------ digest


def statuses_of(words: dict[int, int], lost: Iterable[int] = (), own: int = 1) -> dict[int, tuple[Level, str]]:
    statuses = {
        a: MemberStatus(MemberState.LOST if a in lost else MemberState.ALIVE, word=word)
        for a, word in words.items()
        if a != own
    }
    return digest.member_levels(Consensus(own, statuses), words[own])


def bad(slot: Slot, level: Level = Level.ERROR) -> int:
    return status_word.encode({**dict.fromkeys(list(Slot)[:8], Level.OK), slot: level})


@pytest.mark.parametrize(
    ("words", "lost", "line"),
    [
        (dict.fromkeys(range(1, 9), HEALTHY), (), "SWARM 8/8 OK"),
        ({**dict.fromkeys(range(1, 9), HEALTHY), 3: bad(Slot.NODES)}, (), "SWARM 7/8 FAIL A03:ROS"),
        (
            {**dict.fromkeys(range(1, 9), HEALTHY), 3: bad(Slot.NODES)},
            (6, 7),
            "SWARM 5/8 FAIL A06:lost A07:lost A03:ROS",
        ),
        ({**dict.fromkeys(range(1, 9), HEALTHY), 2: bad(Slot.HOST, Level.WARN)}, (), "SWARM 7/8 WARN A02:HOST"),
        ({**dict.fromkeys(range(1, 9), HEALTHY), 2: bad(Slot.PEERS)}, (), "SWARM 8/8 OK"),
        ({1: 0, 2: HEALTHY}, (), "SWARM 1/2 OK A01:unknown"),
        (dict.fromkeys(range(1, 101), bad(Slot.CONTAINER)), (), "SWARM 0/100 FAIL A01:DOCKER A02:DOCKER +98"),
    ],
)
def test_the_line_names_agents_that_are_not_ok(words: dict[int, int], lost: tuple[int, ...], line: str) -> None:
    """With their bad layer; those that do not fit are counted."""
    assert digest.digest_line(statuses_of(words, lost)) == line


@given(st.dictionaries(st.integers(1, 250), st.integers(0, 2**32 - 1), min_size=1), st.data())
def test_the_line_always_fits(words: dict[int, int], data: st.DataObject) -> None:
    """A digest line is ASCII of at most 50 characters, whatever the states of the swarm are."""
    own = data.draw(st.sampled_from(sorted(words)))
    lost = data.draw(st.sets(st.sampled_from(sorted(words)))) - {own}
    line = digest.digest_line(statuses_of(words, lost, own))
    assert len(line) <= 50
    assert line.isascii()


def test_an_agent_without_a_gcs_is_named_unless_it_has_a_worse_failure() -> None:
    """One agent has one place in the line."""
    statuses = {
        2: MemberStatus(MemberState.ALIVE, gcs=False, word=HEALTHY),
        3: MemberStatus(MemberState.ALIVE, gcs=False, word=bad(Slot.NODES)),
    }
    assert (
        digest.digest_line(digest.member_levels(Consensus(1, statuses), HEALTHY, no_gcs=(2, 3)))
        == "SWARM 1/3 FAIL A03:ROS A02:no-GCS"
    )


def test_a_lost_gcs_does_not_hide_other_failures() -> None:
    """It reports its own lost ground link (slot 1 or 11, and 10 unknown); the ground needs its other states."""
    way = {Slot.COMPANION: Level.ERROR, Slot.RADIO: Level.ERROR, Slot.AUTOPILOT: Level.STALE}
    healthy, broken = (
        dict.fromkeys(list(Slot)[:8], Level.OK) | way | more for more in ({}, {Slot.CONTAINER: Level.ERROR})
    )
    words = [status_word.encode(levels) for levels in (healthy, broken)]
    assert digest.relay_line(3, [1, 2], words[0]) == "A03 no GCS radio, received by A01 A02: OK"
    assert digest.relay_line(3, [1, 2], words[1]) == "A03 no GCS radio, received by A01 A02: 2 ERROR"
    assert [int(digest.relay_severity(word)) for word in words] == [4, 2]
    statuses = {agent: MemberStatus(MemberState.ALIVE, gcs=False, word=word) for agent, word in enumerate(words, 2)}
    assert (
        digest.digest_line(digest.member_levels(Consensus(1, statuses), HEALTHY, no_gcs=(2, 3)))
        == "SWARM 1/3 FAIL A03:DOCKER A02:no-GCS"
    )
