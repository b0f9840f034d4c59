"""Faults that an earlier run of PHM left open: only an observation ends them."""

from __future__ import annotations

from phm import testing
from phm.api import PeerFact, Result, bypass
from phm.core.model import Evidence, Fault, Level, Outcome
from phm.tracker.faults import ITSELF, TIMEOUT, UNOBSERVED_S, as_unobserved
from phm_checks.peers import SWARM, Peers
from tests.fakes.tracker_bench import BAD, OK, Bench, unit

UNIT = "autopilot"
NOTHING = bypass("nothing received")
UNOBSERVED = NOTHING.with_evidence(Evidence(unobserved=True))
ALIVE, LOST = PeerFact("alive", 1.0, (1,)), PeerFact("lost", 20.0, (), (1,))


def restarted(*, given_up: bool = False) -> Bench:
    """A run of PHM after one in which the unit failed and was acted on."""
    before = Bench([unit(UNIT, target="link:fc")])
    before.all_healthy()
    before.later(1)
    before.see(UNIT, BAD)
    before.take(before.tracker.begin_action("link:fc", UNIT, "reopen", before.stamp(), 5.0))
    (fault,) = before.tracker.open_faults()
    if given_up:
        before.take(before.tracker.escalate(fault.id, before.stamp()))
    return next_run(before)


def next_run(before: Bench) -> Bench:
    """PHM is restarted."""
    after, tracker = Bench(before.tracked, before.now + 10), before.tracker
    after.take(after.tracker.restore(tracker.open_faults(), tracker.given_up(), after.stamp(), tracker.fault_count))
    after.later(1)
    return after


def received(*configured: int, **agents: PeerFact) -> Result:
    """Of the check of the swarm. Without `swarm.agents` it knows only the agents that were received since PHM's start."""
    peers = {int(name[1:]): peer for name, peer in agents.items()}
    living = 1 + sum(peer.state != "lost" for peer in peers.values())
    swarm = testing.FakeSwarm(peers=peers, members=1 + len(peers), living=living)
    return dict(Peers(configured).run(testing.world(swarm=swarm)))[SWARM]


def restarted_without(*lost: int) -> Bench:
    """A run of PHM after one in which these agents of a swarm of five were lost."""
    before = Bench([unit(SWARM)])
    before.all_healthy()
    before.see(SWARM, received(**{f"a{agent}": LOST if agent in lost else ALIVE for agent in (2, 3, 4, 5)}))
    assert before.opened == [SWARM]
    return next_run(before)


def open_fault(bench: Bench) -> list[Fault]:
    return list(bench.tracker.open_faults())


def test_a_subject_not_observed_yet_is_unknown_and_its_fault_stays_open() -> None:
    """`Nothing received` may also mean that it is still lost. Recovery finds it not OK either."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    state = bench.tracker.state(UNIT)
    assert (state.level, state.not_applicable) == (Level.STALE, False)
    assert state.result.summary == "not observed since PHM was restarted: nothing received"
    assert not bench.tracker.found_ok(UNIT, 0.0)
    bench.later(60)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.closed, len(open_fault(bench))) == ([], 1)


def test_an_observation_decides() -> None:
    """OK ends the fault, ERROR continues it; the alarm is not raised twice."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    bench.later(1)
    bench.see(UNIT, BAD)
    assert (bench.level(UNIT), bench.opened, bench.closed) == (Level.ERROR, [], [])
    bench.later(1)
    bench.see(UNIT, OK)
    assert (bench.level(UNIT), bench.closed) == (Level.OK, [(UNIT, Outcome.RESOLVED, ITSELF)])


def test_a_unit_that_was_given_up_is_unknown_too() -> None:
    bench = restarted(given_up=True)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.level(UNIT), len(bench.tracker.given_up())) == (Level.STALE, 1)
    bench.later(1)
    bench.see(UNIT, BAD)
    assert (bench.level(UNIT), bench.opened) == (Level.ERROR, [])


def test_a_subject_that_is_never_observed_again_ends_its_fault_after_a_time() -> None:
    """It may have been removed on purpose. No action is credited."""
    bench = restarted()
    bench.see(UNIT, UNOBSERVED)
    bench.later(UNOBSERVED_S)
    bench.see(UNIT, UNOBSERVED)
    assert (bench.closed, bench.tracker.state(UNIT).not_applicable) == ([(UNIT, Outcome.RESOLVED, TIMEOUT)], True)


def test_what_no_longer_applies_ends_its_fault() -> None:
    """Example: the container has no health check any more."""
    bench = restarted()
    bench.see(UNIT, NOTHING)
    assert bench.closed == [(UNIT, Outcome.RESOLVED, "reopen")]


def test_without_a_restored_fault_nothing_received_is_not_applicable() -> None:
    bench = Bench([unit(UNIT)])
    bench.see(UNIT, UNOBSERVED)
    assert bench.tracker.state(UNIT).not_applicable


def test_other_agents_do_not_end_the_fault_of_one_that_is_lost() -> None:
    """It was lost before the restart, and the new run has not received it: it ends with the first OK that includes it."""
    bench = restarted_without(3)
    bench.see(SWARM, received())
    for agents in ({"a2": ALIVE}, {"a2": ALIVE, "a4": ALIVE, "a5": ALIVE}):
        bench.later(1)
        bench.see(SWARM, received(**agents))
        assert (bench.level(SWARM), bench.closed, len(open_fault(bench))) == (Level.STALE, [], 1)
    assert bench.tracker.state(SWARM).result.summary.startswith("A03 not observed since PHM was restarted: ")
    bench.later(1)
    bench.see(SWARM, received(a2=ALIVE, a3=ALIVE))
    assert (bench.level(SWARM), bench.closed) == (Level.OK, [(SWARM, Outcome.RESOLVED, ITSELF)])


def test_another_loss_after_the_restart_does_not_end_it_either() -> None:
    """One fault reports both; when the second agent is back, the first is still missing."""
    bench = restarted_without(3)
    for second, level in ((ALIVE, Level.STALE), (LOST, Level.ERROR), (ALIVE, Level.STALE)):
        bench.see(SWARM, received(a2=second, a4=ALIVE))
        assert (bench.level(SWARM), bench.opened, bench.closed) == (level, [], [])
        bench.later(1)


def test_a_second_restart_does_not_forget_the_first_loss() -> None:
    """Another agent was lost, and returned, in between."""
    bench = restarted_without(3)
    for second in (LOST, ALIVE):
        bench.see(SWARM, received(a2=second, a4=ALIVE))
        bench.later(1)
    after = next_run(bench)
    after.see(SWARM, received(a2=ALIVE, a4=ALIVE))
    assert (after.level(SWARM), after.closed) == (Level.STALE, [])
    after.later(1)
    after.see(SWARM, received(a2=ALIVE, a3=ALIVE, a4=ALIVE))
    assert after.closed == [(SWARM, Outcome.RESOLVED, ITSELF)]


def test_an_ok_that_does_not_cover_what_failed_ends_nothing() -> None:
    """It names what it has not observed; another failure is over."""
    for subject, level in (("a long run", Level.STALE), ("another", Level.OK)):
        before = Bench([unit(UNIT)])
        before.all_healthy()
        before.see(UNIT, BAD.with_evidence(Evidence(subjects=("a long run",))))
        bench = next_run(before)
        bench.see(UNIT, OK.with_evidence(Evidence(unobserved_of=(subject,))))
        assert (bench.level(UNIT), len(open_fault(bench))) == (level, 1 if level is Level.STALE else 0)
        bench.later(1)
        bench.see(UNIT, OK)
        assert bench.closed == [(UNIT, Outcome.RESOLVED, ITSELF)]


def test_each_lost_agent_must_be_received() -> None:
    bench = restarted_without(3, 4, 5)
    bench.see(SWARM, received(a2=ALIVE, a3=ALIVE, a5=ALIVE))
    assert bench.tracker.state(SWARM).result.summary.startswith("A04 not observed since PHM was restarted: ")
    bench.later(1)
    bench.see(SWARM, received(a2=ALIVE, a3=ALIVE, a4=ALIVE, a5=ALIVE))
    assert bench.closed == [(SWARM, Outcome.RESOLVED, ITSELF)]


def test_an_agent_that_is_never_received_again_ends_the_fault_after_a_time() -> None:
    """It is forgotten: the faults of others end by themselves."""
    bench = restarted_without(3)
    bench.see(SWARM, received(a2=ALIVE))
    bench.later(UNOBSERVED_S)
    bench.see(SWARM, received(a2=ALIVE))
    assert (bench.level(SWARM), bench.closed) == (Level.OK, [(SWARM, Outcome.RESOLVED, TIMEOUT)])
    for second in (LOST, ALIVE):
        bench.later(1)
        bench.see(SWARM, received(a2=second, a4=ALIVE))
    assert bench.closed[1:] == [(SWARM, Outcome.RESOLVED, ITSELF)]


def test_a_list_of_agents_that_was_added_ends_the_fault() -> None:
    """`swarm.agents` is set before the restart: each agent has its own unit, and one that is not listed is ignored."""
    bench = restarted_without(3)
    bench.see(SWARM, received(2, 4, a2=ALIVE))
    assert bench.closed == [(SWARM, Outcome.RESOLVED, ITSELF)]


def test_only_some_of_many_agents_are_named() -> None:
    missing = as_unobserved(OK, [f"A{agent:02d}" for agent in range(1, 11)])
    assert missing.summary.startswith("A01 A02 A03 A04 A05 A06 A07 A08 +2 not observed since")


def test_a_fault_of_this_run_is_never_ended_by_a_timeout() -> None:
    """An action ended it, or it ended by itself: what the check has not observed since PHM's start it cannot have reported."""
    bench = Bench([unit(UNIT, target="link:fc")])
    bench.all_healthy()
    bench.later(1)
    bench.see(UNIT, BAD)
    bench.later(1)
    bench.see(UNIT, UNOBSERVED)
    assert bench.closed == [(UNIT, Outcome.RESOLVED, ITSELF)]
