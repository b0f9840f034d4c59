"""The fusion of evidence: each rule by name, and that no order of evidence changes the verdict."""

from __future__ import annotations

import itertools
from random import Random

import pytest

from phm_checks._liveness import (
    BARE_S,
    BLIND_HANG_S,
    GOODBYE_S,
    HANG_S,
    LOST_S,
    Evidence,
    Kind,
    NodeHistory,
    NodeState,
    Observation,
    fuse,
)


def piece(kind: Kind, says: Observation, lasted_s: float = 0.0, age_s: float = 0.1) -> Evidence:
    return Evidence(kind, says, f"{kind.name.lower()} {says.value}", age_s, lasted_s)


LISTED = piece(Kind.NAME, Observation.ALIVE)
UNLISTED = piece(Kind.NAME, Observation.GONE, lasted_s=1.0)
RUNS = piece(Kind.PROCESS, Observation.ALIVE)
COMPUTES = piece(Kind.PROCESS, Observation.BUSY)
ENDED = piece(Kind.PROCESS, Observation.GONE)
STOPPED = piece(Kind.PROCESS, Observation.STOPPED)
BEATS = piece(Kind.BEACON, Observation.ALIVE)
FLOWS = piece(Kind.TOPICS, Observation.ALIVE)
SILENT = piece(Kind.TOPICS, Observation.SILENT, lasted_s=20.0)


WELL = NodeHistory()


def state(*evidence: Evidence, past: NodeHistory = WELL) -> NodeState:
    return fuse(evidence, past).state


def test_without_evidence_nothing_is_known() -> None:
    """Silence is never OK, and no death either."""
    assert state() is NodeState.UNKNOWN


@pytest.mark.parametrize(
    ("says", "verdict"), [(Observation.GONE, NodeState.DEAD), (Observation.STOPPED, NodeState.HUNG)]
)
def test_nothing_lives_in_a_container_that_does_not_run(says: Observation, verdict: NodeState) -> None:
    """Whatever the graph still lists."""
    assert state(piece(Kind.CONTAINER, says), LISTED, BEATS) is verdict


def test_a_process_that_ended_is_a_dead_node_although_it_is_listed() -> None:
    """The list is stale until the lease ends, up to 20 s."""
    assert state(ENDED, LISTED) is NodeState.DEAD


def test_a_stopped_process_is_a_hung_node() -> None:
    """Listed or not: it is there and will not answer."""
    assert state(STOPPED, LISTED) is NodeState.HUNG
    assert state(STOPPED, UNLISTED, piece(Kind.BEACON, Observation.SILENT, lasted_s=9.0)) is NodeState.HUNG


@pytest.mark.parametrize("sign", [BEATS, FLOWS, piece(Kind.BEACON, Observation.LATE, age_s=0.1)])
@pytest.mark.parametrize("says", [Observation.GONE, Observation.STOPPED])
def test_a_sign_of_life_newer_than_the_list_contradicts_it(sign: Evidence, says: Observation) -> None:
    """It was started anew as another process, or let go since."""
    older, same = piece(Kind.PROCESS, says, age_s=1.0), piece(Kind.PROCESS, says, age_s=0.2)
    assert state(older, sign, LISTED) is not fuse([same, sign, LISTED], NodeHistory()).state
    assert state(same, sign, LISTED) in (NodeState.DEAD, NodeState.HUNG)


def test_a_node_that_says_good_bye_may_go_with_its_container() -> None:
    """For a moment only, and only one that was alive: a dead one that leaves the graph stays dead."""
    left = piece(Kind.NAME, Observation.GONE, lasted_s=GOODBYE_S / 2)
    assert state(ENDED, left) is NodeState.ALIVE
    assert state(left) is NodeState.ALIVE
    assert state(ENDED, left, past=NodeHistory(alive=False)) is NodeState.DEAD
    assert state(left, past=NodeHistory(alive=False)) is NodeState.DEAD
    assert state(ENDED, UNLISTED) is NodeState.DEAD


@pytest.mark.parametrize("lasted_s", [0.7, HANG_S * 4])
def test_a_silent_beacon_of_a_node_that_computes_is_no_death(lasted_s: float) -> None:
    """A busy node is not a dead node, however long."""
    judged = fuse([piece(Kind.BEACON, Observation.SILENT, lasted_s), COMPUTES, LISTED, SILENT], NodeHistory())
    assert (judged.state, judged.busy_s) == (NodeState.ALIVE, lasted_s)


def test_a_silent_beacon_with_flowing_topics_is_no_death() -> None:
    """The beacon was closed, or is filtered."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 60.0), FLOWS, RUNS, LISTED) is NodeState.ALIVE


def test_a_silent_beacon_of_a_sleeping_process_hangs_after_a_while() -> None:
    """Not known at first, so that its topics wait for the answer."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 1.0), RUNS, LISTED, SILENT) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, Observation.SILENT, HANG_S), RUNS, LISTED, SILENT) is NodeState.HUNG


def test_a_silent_beacon_is_a_death_where_nobody_knows_the_process() -> None:
    """Its thread is the beacon's own, so that a hanging executor does not silence it; the list of names is old."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), LISTED) is NodeState.DEAD
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), UNLISTED) is NodeState.DEAD


def test_an_executor_that_does_not_turn_hangs_if_its_process_sleeps() -> None:
    """Slow is not hung: it has HANG_S, and longer where nobody knows whether it computes."""

    def late(lasted_s: float) -> Evidence:
        return piece(Kind.BEACON, Observation.LATE, lasted_s)

    assert state(late(2.0), RUNS, LISTED) is NodeState.UNKNOWN
    assert state(late(HANG_S), RUNS, LISTED) is NodeState.HUNG
    assert state(late(HANG_S), LISTED) is NodeState.UNKNOWN
    assert state(late(BLIND_HANG_S), LISTED) is NodeState.HUNG
    assert state(late(60.0), COMPUTES, LISTED) is NodeState.ALIVE
    assert state(late(60.0), FLOWS, RUNS, LISTED) is NodeState.ALIVE


@pytest.mark.parametrize("says", [Observation.LATE, Observation.SILENT])
def test_what_may_be_busy_is_not_hung(says: Observation) -> None:
    """Its process runs and nobody knows whether it computes: a restart would hit a busy node."""
    unmeasured = Evidence(Kind.PROCESS, Observation.ALIVE, "runs", 0.1, measured=False)
    contained = NodeHistory(contained=True)
    assert state(piece(Kind.BEACON, says, HANG_S), unmeasured, LISTED, past=contained) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, says, 600.0), unmeasured, LISTED, past=contained) is NodeState.UNANSWERING
    assert state(piece(Kind.BEACON, says, HANG_S), RUNS, LISTED, past=contained) is NodeState.HUNG


def test_processes_that_cannot_be_listed_are_no_death() -> None:
    """A beacon may be silent because its process computes; whoever is gone leaves the graph, too."""
    blind = NodeHistory(contained=True, unlisted=True)
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), LISTED, past=blind) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, Observation.SILENT, 600.0), LISTED, past=blind) is NodeState.UNANSWERING
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), UNLISTED, past=blind) is NodeState.DEAD


@pytest.mark.parametrize("sign", [BEATS, FLOWS])
def test_whoever_gives_signs_is_alive_whatever_the_graph_says(sign: Evidence) -> None:
    """A picture of the graph may be behind."""
    assert state(sign, UNLISTED) is NodeState.ALIVE


def test_a_name_that_is_gone_is_dead_or_never_started() -> None:
    """By whether it was alive in this life of its container."""
    assert state(UNLISTED) is NodeState.DEAD
    assert state(UNLISTED, past=NodeHistory(alive=False, seen=False)) is NodeState.NEVER_STARTED


def test_a_name_that_is_gone_while_its_process_runs_gets_time() -> None:
    """A starved machine drops leases; a node that computes is the first to be starved."""

    def gone(lasted_s: float) -> Evidence:
        return piece(Kind.NAME, Observation.GONE, lasted_s)

    assert state(gone(1.0), RUNS) is NodeState.UNKNOWN
    assert state(gone(LOST_S), RUNS) is NodeState.DEAD
    assert state(gone(LOST_S * 4), COMPUTES) is NodeState.UNKNOWN


def test_a_node_that_starts_is_not_known_yet() -> None:
    """After a restart of its container or of itself."""
    assert state(UNLISTED, past=NodeHistory(alive=False, seen=False, starting=True)) is NodeState.UNKNOWN
    assert state(ENDED, UNLISTED, past=NodeHistory(alive=False, starting=True)) is NodeState.DEAD


def test_a_name_without_its_endpoints_is_not_alive() -> None:
    """Unless its process is: then its topics are told, not the node."""

    def bare(lasted_s: float) -> Evidence:
        return piece(Kind.ENDPOINTS, Observation.GONE, lasted_s)

    assert state(bare(0.5), LISTED) is NodeState.UNKNOWN
    assert state(bare(BARE_S), LISTED) is NodeState.DEAD
    assert state(bare(BARE_S), LISTED, past=NodeHistory(starting=True)) is NodeState.UNKNOWN
    assert state(bare(BARE_S), LISTED, RUNS) is NodeState.ALIVE


@pytest.mark.parametrize("process", [(), (RUNS,), (COMPUTES,)])
def test_silent_topics_alone_are_no_death(process: tuple[Evidence, ...]) -> None:
    """A weak sign never stands against others that say alive; the topic is told for itself."""
    assert state(SILENT, LISTED, *process) is NodeState.ALIVE


@pytest.mark.parametrize("sign", [(), (BEATS,), (FLOWS,)])
def test_listed_twice_for_long_is_a_duplicate(sign: tuple[Evidence, ...]) -> None:
    """Alive, but twice."""
    assert state(LISTED, *sign, past=NodeHistory(twice=True)) is NodeState.DUPLICATE


def test_the_decisive_evidence_is_named_first() -> None:
    """Then the rest, the best first."""
    assert fuse([LISTED, SILENT, ENDED], NodeHistory()).words == "process gone; topics silent; name alive"
    assert fuse([SILENT, RUNS, UNLISTED], NodeHistory(alive=False, seen=False)).words.startswith(
        "name gone; process alive"
    )


@pytest.mark.parametrize(
    ("evidence", "past", "decisive"),
    [
        ([LISTED, BEATS, piece(Kind.CONTAINER, Observation.GONE)], WELL, "container gone"),
        ([LISTED, STOPPED, SILENT], WELL, "process stopped"),
        ([LISTED, ENDED, SILENT], WELL, "process gone"),
        ([ENDED, piece(Kind.NAME, Observation.GONE, GOODBYE_S / 2)], WELL, "name gone"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, 60.0), FLOWS], WELL, "topics alive"),
        ([LISTED, COMPUTES, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], WELL, "process busy"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], WELL, "beacon silent"),
        ([LISTED, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], WELL, "beacon silent"),
        ([LISTED, COMPUTES, piece(Kind.BEACON, Observation.LATE, 60.0)], WELL, "process busy"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.LATE, 60.0), FLOWS], WELL, "topics alive"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.LATE, 60.0)], WELL, "beacon late"),
        ([LISTED, RUNS, BEATS, FLOWS], WELL, "beacon alive"),
        ([LISTED, RUNS, BEATS], NodeHistory(twice=True), "name alive"),
        ([UNLISTED, COMPUTES], WELL, "name gone"),
        ([LISTED, SILENT, piece(Kind.ENDPOINTS, Observation.GONE, BARE_S)], WELL, "endpoints gone"),
        ([LISTED, SILENT], WELL, "name alive"),
    ],
)
def test_what_decided_is_told_first(evidence: list[Evidence], past: NodeHistory, decisive: str) -> None:
    """An operator reads the first words, whatever else is known."""
    for order in (evidence, evidence[::-1]):
        assert fuse(order, past).words.partition("; ")[0] == decisive


def test_a_beacon_that_falls_silent_with_a_good_bye_is_not_told_before_it() -> None:
    """The node left the graph properly a moment ago: it may go with its container."""
    left = piece(Kind.NAME, Observation.GONE, lasted_s=GOODBYE_S / 2)
    assert state(left, piece(Kind.BEACON, Observation.SILENT, 0.7)) is NodeState.ALIVE
    assert state(UNLISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, HANG_S)) is NodeState.UNKNOWN


def test_how_long_a_busy_node_has_not_answered_is_told() -> None:
    """Also by a beacon that beats while the executor does not turn; never of a node that does not compute."""
    late = piece(Kind.BEACON, Observation.LATE, 12.0)
    assert fuse([late, COMPUTES, LISTED], NodeHistory()).busy_s == 12.0
    assert fuse([late, RUNS, FLOWS, LISTED], NodeHistory()).busy_s == 0.0
    assert fuse([BEATS, COMPUTES, LISTED], NodeHistory()).busy_s == 0.0


def test_a_bare_name_of_a_node_that_computes_is_no_death() -> None:
    """It may be making its endpoints anew."""
    assert state(piece(Kind.ENDPOINTS, Observation.GONE, BARE_S * 5), LISTED, COMPUTES) is NodeState.ALIVE


def test_no_order_of_evidence_changes_the_verdict() -> None:
    """Drawn sets of evidence, in every order."""
    random = Random(4)
    for _ in range(200):
        kinds = random.sample(list(Kind), 4)
        evidence = [
            piece(kind, random.choice(list(Observation)), random.uniform(0, 20), random.uniform(0, 5)) for kind in kinds
        ]
        past = NodeHistory(*(random.random() < 0.5 for _ in range(4)))
        assert len({fuse(order, past) for order in itertools.permutations(evidence)}) == 1


def test_a_node_that_beats_on_time_is_never_dead_or_hung() -> None:
    """Whatever else is drawn, but for its container and for a list of processes that is newer than its last beat."""
    random = Random(5)
    for _ in range(2000):
        others = [Kind.TOPICS, Kind.ENDPOINTS, Kind.NAME]
        evidence = [piece(kind, random.choice(list(Observation)), random.uniform(0, 20)) for kind in others]
        process = piece(Kind.PROCESS, random.choice(list(Observation)), random.uniform(0, 20), age_s=1.0)
        assert state(BEATS, process, *evidence) is NodeState.ALIVE
