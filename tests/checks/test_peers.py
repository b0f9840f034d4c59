"""Slot 12: which agents are missing, and how several missing agents are one fault."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm import testing
from phm.api import Level, PeerFact, Result
from phm_checks.peers import SETTLE_S, SWARM, Peers

ALIVE = PeerFact("alive", 1.0, (1, 2), ())
LOST = PeerFact("lost", 20.0, (), (1, 2))


def evaluate(peers: dict[int, PeerFact], agents: tuple[int, ...] = (2, 3, 4), **fields: Any) -> dict[str, Result]:
    living = 1 + sum(peer.state != "lost" for peer in peers.values())
    swarm = testing.FakeSwarm(peers=peers, members=1 + len(peers), living=living, **fields)
    return dict(Peers(agents).run(testing.world(swarm=swarm)))


def test_all_agents_alive_is_ok() -> None:
    """The unit of the swarm counts this agent as well."""
    results = evaluate(dict.fromkeys((2, 3, 4), ALIVE))
    assert {result.level for result in results.values()} == {Level.OK}
    assert results[SWARM].summary == "4 of 4 agents of the swarm are alive"


def test_one_lost_agent_is_reported_by_its_own_unit() -> None:
    """`peers/swarm` stays OK."""
    results = evaluate({2: ALIVE, 3: LOST, 4: ALIVE})
    assert (results["peers/A03"].level, results["peers/A03"].condition) == (Level.ERROR, "peer_lost")
    assert results["peers/A03"].brief == "A03 lost"
    assert results[SWARM].level is Level.OK


def test_agents_that_still_receive_the_lost_one_are_named() -> None:
    """So the operator sees that it lives, and who lost it since when."""
    results = evaluate({2: ALIVE, 3: PeerFact("lost", 20.0, (4,), (1, 2)), 4: ALIVE})
    assert "no heartbeat received by A01 A02, here for 20 s, but still received by A04" in results["peers/A03"].summary


def test_a_loss_is_conclusive_when_others_confirm_it() -> None:
    """What only this agent misses may be caused by its own delay."""
    mine = PeerFact("lost", 20.0, (), (1,))
    results = evaluate({2: ALIVE, 3: LOST, 4: mine})
    assert [results[unit].evidence.conclusive for unit in ("peers/A03", "peers/A04")] == [True, False]
    assert evaluate({2: ALIVE, 3: LOST, 4: LOST}, split=(3, 4))[SWARM].evidence.conclusive is True
    assert evaluate({2: LOST, 3: LOST, 4: LOST})[SWARM].evidence.conclusive is False


@pytest.mark.parametrize(
    ("peer", "level", "condition"),
    [
        (PeerFact("never seen", None), Level.WARN, "peer_never_seen"),
        (PeerFact("partly reachable", 2.0, (1,), (2,)), Level.WARN, "peer_partly"),
        (PeerFact("late", 7.0), Level.OK, ""),
        (PeerFact("left", 70.0), Level.OK, ""),
    ],
)
def test_each_other_state_has_its_level_and_condition(peer: PeerFact, level: Level, condition: str) -> None:
    """The unit of the peer has them, whatever the other peers are."""
    result = evaluate({2: ALIVE, 3: peer, 4: ALIVE})["peers/A03"]
    assert (result.level, result.condition) == (level, condition)


def test_a_configured_agent_that_was_never_received_is_missing() -> None:
    """The probe does not know it either."""
    assert evaluate({2: ALIVE}, (2, 9))["peers/A09"].condition == "peer_never_seen"


@pytest.mark.parametrize(
    ("up_s", "heartbeat_s", "level"),
    [(9.0, 2.0, Level.STALE), (11.0, 2.0, Level.WARN), (199.0, 40.0, Level.STALE), (201.0, 40.0, Level.WARN)],
)
def test_an_agent_that_cannot_have_been_received_yet_is_not_known(
    up_s: float, heartbeat_s: float, level: Level
) -> None:
    """As for a lost one, five heartbeats must be missing, and in a large swarm they are far apart."""
    peers = {2: ALIVE, 3: PeerFact("never seen", None)}
    results = evaluate(peers, (2, 3), up_s=up_s, heartbeat_s=heartbeat_s)
    assert (results["peers/A03"].level, results[SWARM].level) == (level, Level.OK)


@pytest.mark.parametrize(
    ("peer", "level"),
    [
        (PeerFact("partly reachable", None, (2,), (1,)), Level.STALE),
        (PeerFact("lost", None, (2,), (1, 3)), Level.STALE),
        (PeerFact("partly reachable", None, (2, 3), (1, 4)), Level.WARN),
        (PeerFact("lost", None, (2,), (1, 3, 4)), Level.ERROR),
        (PeerFact("lost", None, (), (1, 2)), Level.ERROR),
        (PeerFact("lost", 60.0, (2,), (1, 3)), Level.ERROR),
    ],
)
def test_an_agent_has_no_vote_on_those_it_has_not_received_since_its_start(peer: PeerFact, level: Level) -> None:
    """What the others report without it counts, and what it has received and lost."""
    assert evaluate({60: peer}, (60,), up_s=60.0, heartbeat_s=40.0)["peers/A60"].level is level


def test_a_split_is_one_fault_and_the_cause_of_the_single_losses() -> None:
    """Each agent's unit needs `peers/swarm`, which names both parts."""
    check = Peers((2, 3, 4))
    assert all(unit.needs == (SWARM,) for unit in check.units if unit.id != SWARM)
    result = evaluate({2: ALIVE, 3: LOST, 4: LOST}, split=(3, 4))[SWARM]
    assert (result.level, result.condition) == (Level.ERROR, "swarm_split")
    assert "A03 A04 disappeared together and A01 A02 are still reachable" in result.summary


def test_agents_that_return_one_by_one_are_not_reported_each_time() -> None:
    """Not until they have been back for a while and the others have not."""
    check = Peers((2, 3, 4, 5))

    def brief(**states: PeerFact) -> str:
        peers = {2: ALIVE, **{int(name[1:]): peer for name, peer in states.items()}}
        lost = tuple(agent for agent, peer in peers.items() if peer.state == "lost")
        split = tuple(agent for agent in lost if not peers[agent].received_by)
        split = split if len(split) > 1 else ()
        swarm = testing.FakeSwarm(peers=peers, members=5, living=5 - len(lost), split=split)
        return dict(check.run(testing.world(swarm=swarm)))[SWARM].brief

    back = PeerFact("alive", 0.1, (1, 2), (), since_s=0.1)
    partly = PeerFact("partly reachable", 0.1, (1,), (2,), since_s=0.1)
    assert brief(a3=LOST, a4=LOST, a5=LOST) == "split 2/5 lost A03 A04 A05"
    assert brief(a3=LOST, a4=LOST, a5=replace(LOST, received_by=(1,))) == "split 2/5 lost A03 A04 A05"
    assert brief(a3=LOST, a4=LOST, a5=partly) == "split 2/5 lost A03 A04 A05"
    assert brief(a3=LOST, a4=LOST, a5=back) == "split 2/5 lost A03 A04 A05"
    assert brief(a3=LOST, a4=LOST, a5=replace(back, since_s=SETTLE_S)) == "split 3/5 lost A03 A04"
    assert brief(a3=LOST, a4=back, a5=back) == ""
    assert brief(a3=LOST, a4=LOST, a5=back) == "split 3/5 lost A03 A04"


def test_losing_all_agents_is_a_fault_of_the_own_radio() -> None:
    """The condition is `all_peers_lost`, not one fault for each agent."""
    result = evaluate({2: LOST, 3: LOST, 4: LOST}, split=(2, 3, 4))[SWARM]
    assert (result.condition, result.brief) == ("all_peers_lost", "all peers lost")


def test_agents_lost_one_after_the_other_were_not_lost_together() -> None:
    """The last one is more likely to have failed than this agent's own link."""
    result = evaluate({2: PeerFact("lost", 1200.0, (), (1,)), 3: PeerFact("lost", 12.0, (), (1,))})[SWARM]
    assert (result.condition, result.brief) == ("all_peers_lost", "all peers lost")
    assert "A03 for 12 s, A02 for 20 min: check the vehicle of A03 first" in result.summary
    assert "together" not in result.summary


@pytest.mark.parametrize("other", [PeerFact("never seen", None), PeerFact("left", 70.0)])
def test_an_agent_that_is_not_there_does_not_make_a_split_of_it(other: PeerFact) -> None:
    """It was never switched on, or has left: all that could be received were lost."""
    result = evaluate({2: LOST, 3: LOST, 4: other}, split=(2, 3))[SWARM]
    assert (result.condition, result.brief) == ("all_peers_lost", "all peers lost")


def test_an_agent_that_receives_others_is_not_isolated() -> None:
    """Regardless of what these report of each other."""
    partly_lost = PeerFact("lost", 1.0, (1,), (2, 3))
    assert evaluate({2: partly_lost, 3: partly_lost}, (2, 3))[SWARM].level is Level.OK


def test_the_only_other_agent_lost_is_reported_as_lost() -> None:
    """In a swarm of two a lost peer and an own radio that is off look alike."""
    results = evaluate({2: LOST}, (2,))
    assert results[SWARM].level is Level.OK
    assert results["peers/A02"].level is Level.ERROR


def test_a_duplicate_id_is_reported_first() -> None:
    """Two agents with one id are named before anything else."""
    result = evaluate({2: ALIVE}, duplicate_ids=(2,))[SWARM]
    assert (result.condition, result.brief) == ("agent_id_duplicate", "A02 id used twice")


def test_without_configuration_received_agents_are_expected() -> None:
    """An agent that was received once is expected from then on."""
    result = evaluate({2: ALIVE, 3: LOST}, ())[SWARM]
    assert (result.level, result.brief) == (Level.ERROR, "A03 lost")


def test_each_further_lost_agent_changes_the_brief() -> None:
    """PHM reports a changed brief to the ground: also when some of them are back."""
    peers = dict.fromkeys(range(2, 9), ALIVE)
    briefs = [
        evaluate({**peers, **dict.fromkeys(lost, LOST)}, ())[SWARM].brief
        for lost in ((3,), (3, 5), (3, 5, 6), (3, 5, 6, 7), (5, 6, 7), (5,))
    ]
    assert briefs == ["A03 lost", "A03 A05 lost", "A03 A05 A06 lost", "A03 lost (+3)", "A05 A06 A07 lost", "A05 lost"]


def test_without_configuration_a_received_agent_is_lost_no_sooner_than_a_configured_one() -> None:
    """A report that is still in transit may say that it is alive, or that several are lost."""
    fresh = PeerFact("partly reachable", 7.0, (1,), (2,), since_s=1.0)
    assert evaluate({2: ALIVE, 3: fresh}, ())[SWARM].level is Level.OK
    lasting = PeerFact("partly reachable", 7.0, (1,), (2,), since_s=SETTLE_S)
    assert evaluate({2: ALIVE, 3: lasting}, ())[SWARM].condition == "peer_partly"


def test_a_common_loss_is_reported_immediately_and_single_agents_after_it() -> None:
    """Single losses settle, so that the cause is known first."""
    whole, *single = Peers((2, 3)).units
    assert (whole.settle_s, {unit.settle_s for unit in single}) == (0.0, {SETTLE_S})


def test_without_expected_agents_being_alone_is_ok() -> None:
    """The result is a bypass: there is nothing to compare with."""
    result = evaluate({}, ())[SWARM]
    assert result.level is Level.OK
    assert result.bypass and result.evidence.unobserved


def test_without_links_no_check_is_built() -> None:
    """Without an endpoint there is no check; with one, an agent that is named twice has one unit."""
    assert Peers.build(testing.settings()) == []
    (check,) = Peers.build(
        testing.settings(mavlink={"endpoints": [{"url": "udpout:127.0.0.1:1"}]}, swarm={"agents": [1, 2, 2, 3]})
    )
    assert [unit.id for unit in check.units] == [SWARM, "peers/A02", "peers/A03"]


def test_an_agent_that_is_received_again_is_not_lost_although_it_receives_none() -> None:
    """The fault of its loss ends: a second loss must be an alarm."""
    result = evaluate({2: ALIVE, 3: ALIVE, 4: ALIVE}, receive_none=(2,))["peers/A02"]
    assert (result.level, result.condition) == (Level.WARN, "peer_receives_none")
    assert result.evidence.recovered
