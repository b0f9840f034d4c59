"""Fusion of evidence: each rule by name, and the order of evidence does not change the verdict."""

from __future__ import annotations

import itertools
from dataclasses import replace
from random import Random

import pytest

from phm.tracker.rules import UNKNOWN_NEED_S
from phm_checks._evidence import EvidencePiece, Kind, Observation
from phm_checks._liveness import (
    BARE_S,
    BLIND_HANG_S,
    CERTAIN_HANG_S,
    DISPROVED_S,
    GOODBYE_S,
    HANG_S,
    LOST_S,
    MUTE_S,
    NodeHistory,
    NodeState,
    disproved,
    judge_node,
)


def piece(kind: Kind, says: Observation, lasted_s: float = 0.0, age_s: float = 0.1) -> EvidencePiece:
    return EvidencePiece(kind, says, f"{kind.name.lower()} {says.value}", age_s, lasted_s)


LISTED = piece(Kind.NAME, Observation.ALIVE)
UNLISTED = piece(Kind.NAME, Observation.GONE, lasted_s=1.0)
RUNS = piece(Kind.PROCESS, Observation.ALIVE)
COMPUTES = piece(Kind.PROCESS, Observation.BUSY)
ENDED = piece(Kind.PROCESS, Observation.GONE)
STOPPED = piece(Kind.PROCESS, Observation.STOPPED)
BEACON_ALIVE = piece(Kind.BEACON, Observation.ALIVE)
TOPICS_ACTIVE = piece(Kind.TOPICS, Observation.ALIVE)
SILENT = piece(Kind.TOPICS, Observation.SILENT, lasted_s=20.0)


NO_HISTORY = NodeHistory()


def state(*evidence: EvidencePiece, past: NodeHistory = NO_HISTORY) -> NodeState:
    return judge_node(evidence, past).state


def test_without_evidence_the_state_is_unknown() -> None:
    """Silence is never OK, but does not prove a dead node either."""
    assert state() is NodeState.UNKNOWN


@pytest.mark.parametrize(
    ("says", "verdict"), [(Observation.GONE, NodeState.DEAD), (Observation.STOPPED, NodeState.HUNG)]
)
def test_no_node_is_alive_in_a_container_that_does_not_run(says: Observation, verdict: NodeState) -> None:
    """Regardless of what the graph still lists."""
    assert state(piece(Kind.CONTAINER, says), LISTED, BEACON_ALIVE) is verdict


def test_a_terminated_process_is_a_dead_node_although_it_is_listed() -> None:
    """The graph is stale until the lease expires, up to 20 s."""
    assert state(ENDED, LISTED) is NodeState.DEAD


def test_a_stopped_process_is_a_hung_node() -> None:
    """Listed or not: it exists and does not respond."""
    assert state(STOPPED, LISTED) is NodeState.HUNG
    assert state(STOPPED, UNLISTED, piece(Kind.BEACON, Observation.SILENT, lasted_s=9.0)) is NodeState.HUNG


SIGNS = [BEACON_ALIVE, TOPICS_ACTIVE, piece(Kind.BEACON, Observation.LATE, age_s=0.1)]


@pytest.mark.parametrize("sign", SIGNS)
@pytest.mark.parametrize("says", [Observation.GONE, Observation.STOPPED])
def test_a_sign_of_life_newer_than_the_process_list_contradicts_it(sign: EvidencePiece, says: Observation) -> None:
    """The node was restarted as another process, or resumed since."""
    overdue = replace(sign, overdue=True)
    older, same = piece(Kind.PROCESS, says, age_s=1.0), piece(Kind.PROCESS, says, age_s=0.2)
    assert state(older, overdue, LISTED) is not judge_node([same, overdue, LISTED], NodeHistory()).state
    assert state(same, overdue, LISTED) in (NodeState.DEAD, NodeState.HUNG)


@pytest.mark.parametrize("sign", SIGNS)
@pytest.mark.parametrize("says", [Observation.GONE, Observation.STOPPED])
def test_a_listed_node_whose_next_message_is_not_late_may_have_another_process(
    sign: EvidencePiece, says: Observation
) -> None:
    """What ended or is stopped may be a tool with its name. Without its name in the graph, or when its beacon is late, it counts."""
    found = piece(Kind.PROCESS, says, age_s=0.2)
    assert state(found, sign, LISTED) in (NodeState.ALIVE, NodeState.UNKNOWN)
    assert state(found, sign, UNLISTED) in (NodeState.DEAD, NodeState.HUNG)
    late = piece(Kind.BEACON, Observation.SILENT, lasted_s=0.7)
    assert state(found, late, TOPICS_ACTIVE, LISTED) in (NodeState.DEAD, NodeState.HUNG)


@pytest.mark.parametrize("sign", SIGNS)
def test_an_ended_process_is_disproved_by_messages_that_are_certainly_newer(sign: EvidencePiece) -> None:
    """Later than any message of the process may arrive; a stopped process may have been resumed."""
    assert disproved([piece(Kind.PROCESS, Observation.GONE, lasted_s=DISPROVED_S + 0.2), sign])
    assert not disproved([piece(Kind.PROCESS, Observation.GONE, lasted_s=DISPROVED_S), sign])
    assert not disproved([piece(Kind.PROCESS, Observation.STOPPED, lasted_s=60.0), sign])
    assert not disproved([piece(Kind.PROCESS, Observation.GONE, lasted_s=60.0), LISTED])


def test_a_node_that_unregisters_may_stop_with_its_container() -> None:
    """For a moment only, and only if it was alive: a dead node that leaves the graph stays dead."""
    left = piece(Kind.NAME, Observation.GONE, lasted_s=GOODBYE_S / 2)
    assert state(ENDED, left) is NodeState.ALIVE
    assert state(left) is NodeState.ALIVE
    assert state(ENDED, left, past=NodeHistory(alive=False)) is NodeState.DEAD
    assert state(left, past=NodeHistory(alive=False)) is NodeState.DEAD
    assert state(ENDED, UNLISTED) is NodeState.DEAD


@pytest.mark.parametrize("lasted_s", [0.7, HANG_S * 4])
def test_a_silent_beacon_of_a_computing_node_does_not_prove_it_dead(lasted_s: float) -> None:
    """A busy node is not dead, however long it takes."""
    judged = judge_node([piece(Kind.BEACON, Observation.SILENT, lasted_s), COMPUTES, LISTED, SILENT], NodeHistory())
    assert (judged.state, judged.busy_s) == (NodeState.ALIVE, lasted_s)


def test_a_silent_beacon_with_active_topics_does_not_prove_a_dead_node() -> None:
    """The beacon was closed or is filtered."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 60.0), TOPICS_ACTIVE, RUNS, LISTED) is NodeState.ALIVE


def test_a_silent_beacon_of_a_sleeping_process_is_hung_after_a_while() -> None:
    """Unknown at first, so that its topics wait for the result."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 1.0), RUNS, LISTED, SILENT) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, Observation.SILENT, HANG_S), RUNS, LISTED, SILENT) is NodeState.HUNG


def test_a_silent_beacon_without_a_known_process_is_a_dead_node() -> None:
    """The beacon has its own thread, which a hung executor does not block; the list of names is old."""
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), LISTED) is NodeState.DEAD
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), UNLISTED) is NodeState.DEAD


def test_a_blocked_executor_is_hung_if_its_process_sleeps() -> None:
    """Slow is not hung: it has HANG_S, and longer if it is unknown whether it computes."""

    def late(lasted_s: float) -> EvidencePiece:
        return piece(Kind.BEACON, Observation.LATE, lasted_s)

    assert state(late(2.0), RUNS, LISTED) is NodeState.UNKNOWN
    assert state(late(HANG_S), RUNS, LISTED) is NodeState.HUNG
    assert state(late(HANG_S), LISTED) is NodeState.UNKNOWN
    assert state(late(BLIND_HANG_S), LISTED) is NodeState.HUNG
    assert state(late(60.0), COMPUTES, LISTED) is NodeState.ALIVE
    assert state(late(60.0), TOPICS_ACTIVE, RUNS, LISTED) is NodeState.ALIVE


def test_a_blocked_executor_without_data_is_reported_before_it_is_hung() -> None:
    """Two observations agree: it says that it does not run, and its topics are silent for longer than they ever were. Each alone, or
    beside use of the CPU, may be a short delay."""
    late, overdue = piece(Kind.BEACON, Observation.LATE, 1.6), replace(SILENT, overdue=True, lasted_s=1.2)
    unmeasured, idle = (
        EvidencePiece(Kind.PROCESS, Observation.ALIVE, "runs", 0.1, measured=False),
        replace(RUNS, lasted_s=1.6),
    )
    assert state(late, overdue, idle, LISTED) is NodeState.BLOCKED
    assert state(replace(late, lasted_s=HANG_S), overdue, idle, LISTED) is NodeState.HUNG
    assert state(late, replace(overdue, overdue=False), idle, LISTED) is NodeState.UNKNOWN
    assert state(late, overdue, replace(idle, lasted_s=1.5), LISTED) is NodeState.UNKNOWN
    assert state(late, overdue, unmeasured, LISTED) is state(late, overdue, LISTED) is NodeState.UNKNOWN
    assert state(late, overdue, COMPUTES, LISTED) is NodeState.ALIVE
    silent = piece(Kind.BEACON, Observation.SILENT, 1.6)
    assert state(silent, overdue, idle, LISTED) is NodeState.UNKNOWN
    assert not judge_node([late, overdue, idle, LISTED], NO_HISTORY).witnessed


@pytest.mark.parametrize("says", [Observation.LATE, Observation.SILENT])
def test_a_node_that_may_be_busy_is_not_hung(says: Observation) -> None:
    """Its process runs and may be computing: a restart would hit a busy node."""
    unmeasured = EvidencePiece(Kind.PROCESS, Observation.ALIVE, "runs", 0.1, measured=False)
    contained = NodeHistory(contained=True)
    assert state(piece(Kind.BEACON, says, HANG_S), unmeasured, LISTED, past=contained) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, says, 600.0), unmeasured, LISTED, past=contained) is NodeState.UNANSWERING
    assert state(piece(Kind.BEACON, says, HANG_S), RUNS, LISTED, past=contained) is NodeState.HUNG


def test_an_unavailable_process_list_does_not_prove_a_dead_node() -> None:
    """A beacon may be silent because its process computes; a dead node leaves the graph, too."""
    blind = NodeHistory(contained=True, unlisted=True)
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), LISTED, past=blind) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, Observation.SILENT, 600.0), LISTED, past=blind) is NodeState.UNANSWERING
    assert state(piece(Kind.BEACON, Observation.SILENT, 0.7), UNLISTED, past=blind) is NodeState.DEAD


def test_a_node_without_list_beacon_and_data_does_not_answer_before_its_topics_are_reported() -> None:
    """A topic waits UNKNOWN_NEED_S for its node: by then the node is reported, as one that may also be busy. It gets more time if
    its process is listed, its executor is only late, or its data stopped later.
    """
    blind = NodeHistory(contained=True, unlisted=True)
    unmeasured = EvidencePiece(Kind.PROCESS, Observation.ALIVE, "runs", 0.1, measured=False)

    def after(
        beacon_s: float, topics_s: float, *more: EvidencePiece, says: Observation = Observation.SILENT
    ) -> NodeState:
        topics = piece(Kind.TOPICS, Observation.SILENT, topics_s)
        return state(piece(Kind.BEACON, says, beacon_s), topics, LISTED, *more, past=blind)

    assert after(MUTE_S, MUTE_S) is NodeState.UNANSWERING
    assert after(MUTE_S - 0.1, 60.0) is after(MUTE_S, MUTE_S - 0.1) is NodeState.UNKNOWN
    assert after(MUTE_S, 60.0, unmeasured) is after(MUTE_S, 60.0, says=Observation.LATE) is NodeState.UNKNOWN
    assert state(piece(Kind.BEACON, Observation.SILENT, MUTE_S), TOPICS_ACTIVE, LISTED, past=blind) is NodeState.ALIVE
    assert state(piece(Kind.BEACON, Observation.SILENT, MUTE_S), LISTED, past=blind) is NodeState.UNKNOWN
    assert MUTE_S + 1 < UNKNOWN_NEED_S and LOST_S + 1 < UNKNOWN_NEED_S


@pytest.mark.parametrize("sign", [BEACON_ALIVE, TOPICS_ACTIVE])
def test_a_node_with_signs_of_life_is_alive_regardless_of_the_graph(sign: EvidencePiece) -> None:
    """The snapshot of the graph may be outdated."""
    assert state(sign, UNLISTED) is NodeState.ALIVE


def test_a_name_that_left_the_graph_is_dead_or_never_started() -> None:
    """Depending on whether it was alive in this generation of its container."""
    assert state(UNLISTED) is NodeState.DEAD
    assert state(UNLISTED, past=NodeHistory(alive=False, seen=False)) is NodeState.NEVER_STARTED


def test_a_name_that_left_the_graph_while_its_process_runs_gets_time() -> None:
    """An overloaded machine loses leases, and a computing node loses its lease first."""

    def gone(lasted_s: float) -> EvidencePiece:
        return piece(Kind.NAME, Observation.GONE, lasted_s)

    assert state(gone(1.0), RUNS) is NodeState.UNKNOWN
    assert state(gone(LOST_S), RUNS) is NodeState.DEAD
    assert state(gone(LOST_S * 4), COMPUTES) is NodeState.UNKNOWN


def test_a_starting_node_is_unknown() -> None:
    """After a restart of its container or of the node."""
    assert state(UNLISTED, past=NodeHistory(alive=False, seen=False, starting=True)) is NodeState.UNKNOWN
    assert state(ENDED, UNLISTED, past=NodeHistory(alive=False, starting=True)) is NodeState.DEAD


def test_a_name_without_its_endpoints_is_not_alive() -> None:
    """If its process is known to run, its topics are reported, not the node."""

    def bare(lasted_s: float) -> EvidencePiece:
        return piece(Kind.ENDPOINTS, Observation.GONE, lasted_s)

    assert state(bare(0.5), LISTED) is NodeState.UNKNOWN
    assert state(bare(BARE_S), LISTED) is NodeState.DEAD
    assert state(bare(BARE_S), LISTED, past=NodeHistory(starting=True)) is NodeState.UNKNOWN
    assert state(bare(BARE_S), LISTED, RUNS) is NodeState.ALIVE


@pytest.mark.parametrize("process", [(), (RUNS,), (COMPUTES,)])
def test_silent_topics_alone_do_not_prove_a_dead_node(process: tuple[EvidencePiece, ...]) -> None:
    """Weak evidence never overrides stronger evidence of life; the topic has its own unit."""
    assert state(SILENT, LISTED, *process) is NodeState.ALIVE


def test_the_name_of_a_hung_node_does_not_show_that_it_runs_again() -> None:
    """A hung process still announces it. Data, a beacon, or use of the CPU show more."""
    hung = NodeHistory(alive=False, hung=True)
    assert state(LISTED, RUNS, past=hung) is state(LISTED, RUNS, SILENT, past=hung) is NodeState.UNKNOWN
    assert state(LISTED, RUNS, piece(Kind.ENDPOINTS, Observation.GONE, BARE_S), past=hung) is NodeState.UNKNOWN
    for sign in (COMPUTES, BEACON_ALIVE, TOPICS_ACTIVE):
        assert state(LISTED, sign, past=hung) is NodeState.ALIVE


@pytest.mark.parametrize("sign", [(), (BEACON_ALIVE,), (TOPICS_ACTIVE,)])
def test_a_name_listed_twice_for_long_is_a_duplicate(sign: tuple[EvidencePiece, ...]) -> None:
    """Alive, but twice."""
    assert state(LISTED, *sign, past=NodeHistory(twice=True)) is NodeState.DUPLICATE


def test_the_decisive_evidence_comes_first() -> None:
    """Then the others, strongest first."""
    assert judge_node([LISTED, SILENT, ENDED], NodeHistory()).words == "process gone; topics silent; name alive"
    assert judge_node([SILENT, RUNS, UNLISTED], NodeHistory(alive=False, seen=False)).words.startswith(
        "name gone; process alive"
    )


@pytest.mark.parametrize(
    ("evidence", "past", "decisive"),
    [
        ([LISTED, BEACON_ALIVE, piece(Kind.CONTAINER, Observation.GONE)], NO_HISTORY, "container gone"),
        ([LISTED, STOPPED, SILENT], NO_HISTORY, "process stopped"),
        ([LISTED, ENDED, SILENT], NO_HISTORY, "process gone"),
        ([ENDED, piece(Kind.NAME, Observation.GONE, GOODBYE_S / 2)], NO_HISTORY, "name gone"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, 60.0), TOPICS_ACTIVE], NO_HISTORY, "topics alive"),
        ([LISTED, COMPUTES, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], NO_HISTORY, "process busy"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], NO_HISTORY, "beacon silent"),
        ([LISTED, piece(Kind.BEACON, Observation.SILENT, 60.0), SILENT], NO_HISTORY, "beacon silent"),
        ([LISTED, COMPUTES, piece(Kind.BEACON, Observation.LATE, 60.0)], NO_HISTORY, "process busy"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.LATE, 60.0), TOPICS_ACTIVE], NO_HISTORY, "topics alive"),
        ([LISTED, RUNS, piece(Kind.BEACON, Observation.LATE, 60.0)], NO_HISTORY, "beacon late"),
        ([LISTED, RUNS, BEACON_ALIVE, TOPICS_ACTIVE], NO_HISTORY, "beacon alive"),
        ([LISTED, RUNS, BEACON_ALIVE], NodeHistory(twice=True), "name alive"),
        ([UNLISTED, COMPUTES], NO_HISTORY, "name gone"),
        ([LISTED, SILENT, piece(Kind.ENDPOINTS, Observation.GONE, BARE_S)], NO_HISTORY, "endpoints gone"),
        ([LISTED, SILENT], NO_HISTORY, "name alive"),
    ],
)
def test_the_text_begins_with_the_decisive_evidence(
    evidence: list[EvidencePiece], past: NodeHistory, decisive: str
) -> None:
    """An operator reads the first words only."""
    for order in (evidence, evidence[::-1]):
        assert judge_node(order, past).words.partition("; ")[0] == decisive


def test_a_node_that_unregistered_recently_is_not_reported_for_its_silent_beacon() -> None:
    """It left the graph properly a moment ago: it may be stopping with its container."""
    left = piece(Kind.NAME, Observation.GONE, lasted_s=GOODBYE_S / 2)
    assert state(left, piece(Kind.BEACON, Observation.SILENT, 0.7)) is NodeState.ALIVE
    assert state(UNLISTED, RUNS, piece(Kind.BEACON, Observation.SILENT, HANG_S)) is NodeState.UNKNOWN


@pytest.mark.parametrize(
    ("evidence", "certain"),
    [
        ([RUNS, piece(Kind.BEACON, Observation.LATE, CERTAIN_HANG_S)], True),
        ([RUNS, piece(Kind.BEACON, Observation.LATE, CERTAIN_HANG_S - 0.1)], False),
        ([RUNS, piece(Kind.BEACON, Observation.SILENT, 60.0)], False),
        ([piece(Kind.BEACON, Observation.LATE, 60.0)], False),
        (
            [
                EvidencePiece(Kind.PROCESS, Observation.ALIVE, "runs", measured=False),
                piece(Kind.BEACON, Observation.LATE, 60.0),
            ],
            False,
        ),
        (
            [
                RUNS,
                piece(Kind.BEACON, Observation.LATE, 60.0),
                piece(Kind.TOPICS, Observation.SILENT, CERTAIN_HANG_S - 0.1),
            ],
            False,
        ),
    ],
)
def test_starvation_does_not_block_an_executor_whose_beacon_is_in_time(
    evidence: list[EvidencePiece], certain: bool
) -> None:
    """For long: its process gets the CPU and does not use it. If the beacon is silent too, its CPU use unknown, or it published
    meanwhile, it may be starved."""
    verdict = judge_node([SILENT, *evidence, LISTED], NO_HISTORY)
    assert verdict.state is NodeState.HUNG
    assert verdict.witnessed is certain


def test_the_text_has_how_long_a_busy_node_has_not_responded() -> None:
    """Also when the beacon is alive while the executor is blocked; never for a node that does not compute."""
    late = piece(Kind.BEACON, Observation.LATE, 12.0)
    assert judge_node([late, COMPUTES, LISTED], NodeHistory()).busy_s == 12.0
    assert judge_node([late, RUNS, TOPICS_ACTIVE, LISTED], NodeHistory()).busy_s == 0.0
    assert judge_node([BEACON_ALIVE, COMPUTES, LISTED], NodeHistory()).busy_s == 0.0


def test_a_bare_name_of_a_computing_node_does_not_prove_it_dead() -> None:
    """It may be recreating its endpoints."""
    assert state(piece(Kind.ENDPOINTS, Observation.GONE, BARE_S * 5), LISTED, COMPUTES) is NodeState.ALIVE


def test_the_order_of_evidence_does_not_change_the_verdict() -> None:
    """Random sets of evidence, in every order."""
    random = Random(4)
    for _ in range(200):
        kinds = random.sample(list(Kind), 4)
        evidence = [
            piece(kind, random.choice(list(Observation)), random.uniform(0, 20), random.uniform(0, 5)) for kind in kinds
        ]
        past = NodeHistory(*(random.random() < 0.5 for _ in range(4)))
        assert len({judge_node(order, past) for order in itertools.permutations(evidence)}) == 1


def test_a_node_with_a_timely_beacon_is_never_dead_or_hung() -> None:
    """Whatever the other evidence, except its container and a process list newer than its last heartbeat."""
    random = Random(5)
    for _ in range(2000):
        others = [Kind.TOPICS, Kind.ENDPOINTS, Kind.NAME]
        evidence = [piece(kind, random.choice(list(Observation)), random.uniform(0, 20)) for kind in others]
        process = piece(Kind.PROCESS, random.choice(list(Observation)), random.uniform(0, 20), age_s=1.0)
        assert state(BEACON_ALIVE, process, *evidence) is NodeState.ALIVE
