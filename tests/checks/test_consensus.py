"""Slot 6: rules of the consensus: quorum, disagreement, split, and what the nodes check reports instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from phm import api, testing
from phm_checks._node_consensus import PHM, Agreement, Verdict, agree
from phm_checks.consensus import Consensus
from tests.fakes.consensus_bench import ALL, A, B, C, D, Quorum, beacon, both, matrix


def opinions(agreement: Agreement) -> dict[str, Verdict]:
    return {item.node: item.verdict for item in agreement.opinions}


# ---------------------------------------------------------------- the quorum


def test_nodes_that_all_receive_each_other_are_alive() -> None:
    """Every observer reports every node alive, PHM included."""
    agreement = agree(matrix(A, B, C), {})
    assert opinions(agreement) == dict.fromkeys((A, B, C), Verdict.ALIVE)
    assert agreement.observers == (A, B, C, PHM)
    assert not agreement.split and not agreement.disagreements


def test_a_node_that_no_observer_receives_is_dead_without_disagreement() -> None:
    """It does not count as an observer either: its last reports are ignored."""
    beacons = matrix(A, B, C, not_received=((A, C), (B, C)))
    beacons[C] = beacon({A: False, B: False}, age_s=5.0, witness=C)
    agreement = agree(beacons, {})
    assert opinions(agreement) == {A: Verdict.ALIVE, B: Verdict.ALIVE, C: Verdict.DEAD}
    assert agreement.observers == (A, B, PHM)
    assert not agreement.split and not agreement.disagreements


def test_the_majority_overrules_phm() -> None:
    """Only PHM does not receive the node: the node is alive, and PHM is the one that disagrees."""
    beacons = matrix(A, B, C)
    beacons[C] = beacon({}, age_s=5.0, witness=C)
    (found,) = agree(beacons, {}).disagreements
    assert (found.node, found.verdict, found.received_by, found.not_received_by) == (C, Verdict.ALIVE, (A, B), (PHM,))


def test_the_majority_confirms_phm() -> None:
    """One of three does not receive it."""
    (found,) = agree(matrix(A, B, C, not_received=((A, B),)), {}).disagreements
    assert (found.node, found.verdict, found.received_by, found.not_received_by) == (B, Verdict.ALIVE, (C, PHM), (A,))


def test_a_tie_decides_nothing() -> None:
    """Two observers with different opinions."""
    agreement = agree(matrix(A, B, not_received=((A, B),)), {})
    assert opinions(agreement) == {A: Verdict.ALIVE, B: Verdict.UNDECIDED}
    assert not agreement.split, "one direction still works"


def test_nodes_of_one_process_are_one_observer() -> None:
    """Five nodes that share one DDS participant do not outvote two separate ones."""
    names = [f"/agent_1/n{number}" for number in range(5)]
    beacons = {name: beacon({A: False, B: True}, witness="one") for name in names}
    beacons[A] = beacon({**dict.fromkeys(names, True), B: True}, witness="a")
    beacons[B] = beacon({**dict.fromkeys(names, True), A: True}, witness="b")
    (found,) = agree(beacons, {}).disagreements
    assert (found.verdict, found.received_by, found.not_received_by) == (Verdict.ALIVE, (B, PHM), (names[0],))


def test_an_observer_without_time_for_discovery_has_no_opinion() -> None:
    """A node that started a second ago does not yet count as not received; after ten seconds it does."""
    beacons = {A: beacon({}, witness=A), B: beacon({A: True}, witness=B, heartbeats=5)}
    assert not agree(beacons, {}).disagreements
    beacons[B] = beacon({A: True}, witness=B, heartbeats=50)
    assert [item.node for item in agree(beacons, {}).disagreements] == [B]


def test_no_node_is_silent_while_phm_itself_is_late() -> None:
    """The age of the snapshot is subtracted."""
    beacons = {name: beacon({}, age_s=2.1, witness=name, heartbeats=5) for name in (A, B)}
    assert opinions(agree(beacons, {}, late_s=2.0)) == {A: Verdict.ALIVE, B: Verdict.ALIVE}
    assert opinions(agree(beacons, {})) == {A: Verdict.DEAD, B: Verdict.DEAD}


def test_a_node_with_a_blocked_executor_is_hung_and_still_an_observer() -> None:
    """Another thread receives for it."""
    beacons = matrix(A, B)
    beacons[B] = beacon({A: True}, witness=B, late_s=6.0)
    agreement = agree(beacons, {})
    assert opinions(agreement) == {A: Verdict.ALIVE, B: Verdict.HUNG}
    assert B in agreement.observers and B in agreement.alive


@pytest.mark.parametrize(
    ("not_received", "sides"),
    [
        (both((A, C), (A, D), (B, C), (B, D)), ((A, B), (C, D))),
        (both((A, B), (A, C), (A, D)), ((A,), (B, C, D))),
        (both((A, B), (A, C), (A, D), (B, C), (B, D), (C, D)), ((A,), (B,), (C,), (D,))),
        (both((A, B), (C, D)), ((A, B, C, D),)),
        (((A, C), (A, D), (B, C), (B, D)), ((A, B, C, D),)),
    ],
)
def test_sides_are_groups_that_do_not_receive_each_other(
    not_received: tuple[tuple[str, str], ...], sides: tuple[tuple[str, ...], ...]
) -> None:
    """In neither direction, not even through others; a split is not reported as disagreement too."""
    agreement = agree(matrix(*ALL, not_received=not_received), {})
    assert agreement.sides == sides
    assert bool(agreement.disagreements) is not agreement.split


def test_a_node_without_a_beacon_is_observed_by_phm_only() -> None:
    """Received, it is alive; not received, it is undecided because no other node can observe it."""
    agreement = agree(matrix(A, B), {C: True, D: False})
    assert opinions(agreement) == {A: Verdict.ALIVE, B: Verdict.ALIVE, C: Verdict.ALIVE, D: Verdict.UNDECIDED}
    assert not agreement.disagreements


# ---------------------------------------------------------------- the check


def build(*names: str, container: bool = True, **node: Any) -> Consensus:
    settings = testing.settings(
        containers=[{"name": "ros_app"}] if container else [],
        ros={"nodes": [{"name": name, **node} for name in names or (A, B, C)]},
    )
    (check,) = Consensus.build(settings)
    assert isinstance(check, Consensus)
    return check


def evaluate(beacons: Mapping[str, api.BeaconFact], check: Consensus | None = None, **ros: Any) -> api.Result:
    given: dict[str, Any] = {"up_s": 60.0, "nodes": dict.fromkeys(ALL, 1), **ros}
    return (check or build()).run(testing.world(ros=testing.FakeRos(beacons=beacons, **given)))


def test_agreement_is_ok() -> None:
    """The summary names the observers."""
    result = evaluate(matrix(A, B, C))
    assert result.level is api.Level.OK and not result.bypass
    assert result.summary == "3 of 3 nodes are alive according to agent_1/a, agent_1/b, agent_1/c, PHM"
    assert dict(result.values) == {"nodes": 3, "alive": 3, "hung": 0, "observers": 4, "beacons": 3, "refused": 0}


def test_the_check_depends_on_its_nodes_and_their_container() -> None:
    """The nodes check reports a dead or hung node; reports of its neighbours are a consequence."""
    (unit,) = build(A, B).units
    assert unit.needs == ("container/ros_app", "network/ros_app", "nodes/agent_1/a", "nodes/agent_1/b")
    assert (unit.id, unit.target, unit.settle_s, unit.grace_s) == ("consensus", "ros_app", 3.0, 8.0)
    assert build(A, container=False).units[0].needs == ("nodes/agent_1/a",)


def test_without_configured_nodes_no_check_is_built() -> None:
    """There is nothing to check."""
    assert not list(Consensus.build(testing.settings()))


def test_without_beacons_the_result_is_a_bypass() -> None:
    """Beacons are optional."""
    assert evaluate({}).bypass
    assert evaluate({A: beacon(age_s=61.0)}).bypass, "one that was closed long ago"


def test_a_disagreement_is_a_warning_with_all_names() -> None:
    """The node that is not received, the observers that miss it and those that receive it."""
    result = evaluate(matrix(A, B, C, not_received=((A, B),)))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "partly_received", "b not seen by a")
    assert result.summary.startswith(
        "agent_1/b is not received by agent_1/a, but is received by agent_1/c, PHM: check the network"
    )
    assert "FASTDDS_BUILTIN_TRANSPORTS" in result.summary


def test_a_split_is_a_warning_that_names_the_sides() -> None:
    """The larger side first."""
    result = evaluate(matrix(*ALL, not_received=both((A, B), (A, C), (A, D))), build(*ALL))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "nodes_split", "nodes split 3|1")
    assert "agent_1/b, agent_1/c, agent_1/d | agent_1/a do not receive each other" in result.summary


def test_a_hung_node_is_mentioned_without_a_second_alarm() -> None:
    """The nodes check reports it."""
    beacons = {**matrix(A, B, C), C: beacon({A: True, B: True}, witness=C, late_s=9.0)}
    result = evaluate(beacons)
    assert result.level is api.Level.OK
    assert result.summary.endswith("; the executor of agent_1/c is blocked")
    assert result.values["hung"] == 1


def test_a_dead_node_raises_no_second_alarm() -> None:
    """All observers agree that it is dead."""
    beacons = matrix(A, B, C, not_received=((A, C), (B, C)))
    beacons[C] = beacon({}, age_s=5.0, witness=C)
    result = evaluate(beacons)
    assert result.level is api.Level.OK
    assert result.summary.startswith("2 of 3 nodes are alive")


def test_unconfigured_nodes_have_no_vote() -> None:
    """Nodes that are not configured, such as those of another agent, are not observers and not judged."""
    unconfigured = beacon({A: False, B: False}, witness="s")
    result = evaluate({**matrix(A, B), "/agent_2/x": unconfigured}, build(A, B))
    assert result.level is api.Level.OK and "agent_2" not in result.summary


def test_when_all_nodes_are_silent_the_consensus_is_stale() -> None:
    """The nodes check reports the silence."""
    assert evaluate({A: beacon(age_s=3.0), B: beacon(age_s=3.0)}).level is api.Level.STALE


@pytest.mark.parametrize("ros", [{"age_s": 5.5}, None])
def test_without_a_current_snapshot_the_consensus_is_stale(ros: dict[str, Any] | None) -> None:
    """PHM itself receives nothing."""
    if ros is not None:
        assert evaluate(matrix(A, B, C), **ros).level is api.Level.STALE
        return
    blind = testing.FakeRos()
    blind.fail("no child")
    result = build().run(testing.world(ros=blind))
    assert (result.level, result.summary) == (api.Level.STALE, "no child")


def active_topic(node: str, hz: float = 10.0) -> dict[str, api.TopicFact]:
    return {"/t": api.TopicFact((api.EndpointFact(node, "std_msgs/msg/String"),), (), api.RateFact(hz, 0.1))}


@pytest.mark.parametrize(
    ("ros", "words"),
    [
        ({"topics": active_topic(C)}, "; agent_1/c without a beacon, observed by PHM only"),
        ({"topics": active_topic(C, 0.0)}, "; no observer for agent_1/c"),
        (
            {"diagnostics": {"c: loop": api.DiagnosticFact(1.0, 0)}},
            "; agent_1/c without a beacon, observed by PHM only",
        ),
        (
            {"diagnostics": {"/agent_1/c: x": api.DiagnosticFact(1.0, 2)}},
            "; agent_1/c without a beacon, observed by PHM only",
        ),
        ({"diagnostics": {"c: loop": api.DiagnosticFact(9.0, 0)}}, "; no observer for agent_1/c"),
        ({"diagnostics": {"cc: loop": api.DiagnosticFact(1.0, 0)}}, "; no observer for agent_1/c"),
        ({}, "; no observer for agent_1/c"),
    ],
)
def test_nodes_without_a_beacon_take_part_by_topics_and_diagnostics(ros: dict[str, Any], words: str) -> None:
    """By a topic that only they publish, or by a diagnostic status whose name begins with theirs."""
    result = evaluate(matrix(A, B), **ros)
    assert result.level is api.Level.OK
    assert result.summary.endswith(words)


def test_a_name_that_two_nodes_share_proves_nothing() -> None:
    """diagnostic_updater omits the namespace."""
    other = "/agent_2/c"
    result = evaluate(matrix(A, B), build(A, B, C, other), diagnostics={"c: loop": api.DiagnosticFact(1.0, 0)})
    assert result.summary.endswith("; no observer for agent_1/c, agent_2/c")


def test_a_missing_required_beacon_is_an_error() -> None:
    """Only for a running node: the nodes check reports a dead one."""
    check = build(A, B, beacon="required")
    result = evaluate({A: beacon({}, witness=A)}, check)
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "beacon_missing", "b has no beacon")
    assert evaluate({A: beacon({}, witness=A)}, check, nodes={A: 1}).level is api.Level.OK
    assert evaluate({**matrix(A, B), B: beacon(age_s=11.0)}, check).condition == "beacon_missing"
    assert evaluate({}, check, up_s=3.0).level is api.Level.STALE


def test_a_slow_required_beacon_is_not_missing() -> None:
    """`Beacon(node, period_s=10)` is missing after three periods, as any other."""
    check = build(A, B, beacon="required")
    slow = {**matrix(A, B), B: beacon(age_s=11.0, period_s=10.0)}
    assert evaluate(slow, check).condition != "beacon_missing"
    slow[B] = beacon(age_s=31.0, period_s=10.0)
    assert evaluate(slow, check).condition == "beacon_missing"


def test_beacons_of_another_version_are_a_warning() -> None:
    """Beacons arrive, but this PHM cannot read them."""
    result = evaluate({}, refused=12)
    assert (result.level, result.condition) == (api.Level.WARN, "beacons_refused")
    assert "12 messages on /phm/beacon were refused" in result.summary
    assert evaluate(matrix(A, B, C), refused=12).level is api.Level.OK


def test_a_second_publisher_of_a_beacon_is_reported() -> None:
    """Its data is rejected, so the consensus is unaffected; the text names it. A duplicate node is another fault."""
    beacons = matrix(A, B, C)
    copied = evaluate({**beacons, A: beacon({B: True, C: True}, witness=A, copied_by="/elsewhere/forger")})
    assert (copied.level, copied.condition, copied.target) == (api.Level.WARN, "beacon_copied", "")
    assert (
        "beacons of agent_1/a also come from a second publisher: /elsewhere/forger; PHM refuses them" in copied.summary
    )
    rival = {**beacons, A: beacon({B: True, C: True}, witness=A, rivals=1)}
    assert evaluate(rival).condition == "beacon_copied"
    assert evaluate(rival, nodes={A: 2, B: 1, C: 1}).level is api.Level.OK


def test_while_beacons_are_lost_the_consensus_makes_no_statement() -> None:
    """A missing required beacon is not reported either."""
    result = evaluate({}, lost_s=1.0)
    assert result.level is api.Level.STALE and "more messages arrive on /phm/beacon than PHM can read" in result.summary
    assert evaluate(matrix(A, B, C), lost_s=60.0).level is api.Level.OK


# ---------------------------------------------------------------- dead by majority


UNSEEN = ((A, C), (B, C))


def test_a_node_that_most_nodes_do_not_receive_is_an_error() -> None:
    """PHM receives it, its neighbours do not: after 10 s it is dead by majority, and recovery may act on its container."""
    quorum, beacons = Quorum(), matrix(A, B, C, not_received=UNSEEN)
    early = quorum.after(9, beacons)
    assert (early.level, early.condition) == (api.Level.WARN, "partly_received")
    result = quorum.after(2, beacons)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "quorum_dead", "ros_app")
    assert (result.brief, result.settle_s) == ("c dead by majority", 0.0)
    assert result.summary.startswith(
        "agent_1/c is dead by majority: it is not received by agent_1/a, agent_1/b, but is received by PHM"
    )
    assert "FASTDDS_BUILTIN_TRANSPORTS" in result.summary
    assert quorum.after(0, matrix(A, B, C)).level is api.Level.OK


def test_an_observer_whose_list_of_neighbours_is_full_does_not_vote_on_others() -> None:
    """In a large swarm, or after invented greetings, there is no space for a node of its own agent."""
    beacons = {
        A: beacon({B: True}, witness=A, full=True),
        B: beacon({A: True}, witness=B, full=True),
        C: beacon({A: True, B: True}, witness=C),
    }
    assert Quorum().after(60, beacons).level is api.Level.OK
    beacons[A], beacons[B] = (beacon({C: False}, witness=name, full=True) for name in (A, B))
    assert Quorum().after(60, beacons).condition == "quorum_dead", "what it states counts"


def test_a_split_with_a_majority_is_an_error_that_names_the_sides() -> None:
    """The nodes of the smaller side are dead by majority; without a majority it stays a split."""
    quorum = Quorum(*ALL)
    result = quorum.after(11, matrix(*ALL, not_received=both((A, B), (A, C), (A, D))))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "quorum_dead", "a dead by majority")
    assert "agent_1/b, agent_1/c, agent_1/d | agent_1/a do not receive each other" in result.summary
    halves = matrix(*ALL, not_received=both((A, C), (A, D), (B, C), (B, D)))
    result = Quorum(*ALL).after(60, halves)
    assert (result.level, result.condition) == (api.Level.WARN, "nodes_split")


def test_a_node_that_no_observer_receives_is_left_to_the_nodes_check_first() -> None:
    """For 20 s; then it is an error without a target: `nodes` has a reason why it may be alive."""
    quorum, beacons = Quorum(), {**matrix(A, B, C, not_received=UNSEEN), C: beacon({}, age_s=5.0, witness=C)}
    assert quorum.after(19, beacons).level is api.Level.OK
    result = quorum.after(2, beacons)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "quorum_dead", "")
    assert result.settle_s == 5.0 and "PHM restarts nothing for this" in result.summary
    beacons[C] = beacon({}, age_s=300.0, witness=C)
    assert quorum.after(0, beacons).condition == "quorum_dead", "it does not end because the silence is long"


def test_a_closed_beacon_is_not_a_dead_node() -> None:
    """Data arrives from the node, or it has started again since its last heartbeat: it has no beacon any more."""
    silent = {**matrix(A, B, C, not_received=UNSEEN), C: beacon({}, age_s=8.0, witness=C)}
    result = Quorum().after(40, silent, topics=active_topic(C))
    assert result.level is api.Level.OK and result.summary.endswith("agent_1/c without a beacon, observed by PHM only")
    quorum = Quorum()
    quorum.after(1, matrix(A, B, C))
    quorum.after(1, silent, nodes={A: 1, B: 1})
    restarted = {**silent, C: beacon({}, age_s=30.0, witness=C)}
    quorum.after(0, silent, nodes=dict.fromkeys(ALL, 1))
    result = quorum.after(40, {**restarted, C: beacon({}, age_s=45.0, witness=C)})
    assert result.level is api.Level.OK and result.summary.endswith("; no observer for agent_1/c")


def test_a_restarted_node_is_another_case() -> None:
    """Its neighbours need time to discover the new process."""
    quorum, beacons = Quorum(), matrix(A, B, C, not_received=UNSEEN)
    quorum.after(8, beacons)
    restarted = {**beacons, C: beacon({A: True, B: True}, witness="new", birth="new.1")}
    assert quorum.after(8, restarted).level is api.Level.WARN
    assert quorum.after(3, restarted).condition == "quorum_dead"


def test_a_node_never_received_in_this_run_of_its_container_is_not_restarted() -> None:
    """The unit was OK for long before: of two containers, one was started again, and its node is not received since."""
    nodes = [{"name": A, "container": "one"}, {"name": B, "container": "one"}, {"name": C, "container": "two"}]
    quorum = Quorum(containers=("one", "two"), nodes=nodes)

    def after(seconds: int, beacons: Mapping[str, api.BeaconFact], run: str) -> api.Result:
        docker = testing.FakeDocker(testing.container("one"), testing.container("two", started_at=run))
        return quorum.after(seconds, beacons, docker)

    healthy, unseen = matrix(A, B, C), matrix(A, B, C, not_received=UNSEEN)
    after(40, healthy, "first")
    result = after(12, unseen, "first")
    assert (result.condition, result.target, result.evidence.never_ok) == ("quorum_dead", "two", False)
    after(2, healthy, "second")  # reports of its neighbours about the process before
    result = after(12, unseen, "second")
    assert (result.condition, result.evidence.never_ok) == ("quorum_dead", True)
    after(20, healthy, "second")
    assert after(12, unseen, "second").evidence.never_ok is False


def test_phm_alone_is_not_a_majority() -> None:
    """No node has an opinion on a node that started a moment ago."""
    beacons = {A: beacon({}, witness=A, heartbeats=5), B: beacon({}, age_s=5.0, witness=B, heartbeats=5)}
    assert Quorum(A, B).after(60, beacons).condition != "quorum_dead"


def test_an_unknown_consensus_ends_the_verdict() -> None:
    """The time counts from the beginning again."""
    quorum, beacons = Quorum(), matrix(A, B, C, not_received=UNSEEN)
    quorum.after(9, beacons)
    assert quorum.after(0, beacons, age_s=6.0).level is api.Level.STALE
    assert quorum.after(9, beacons, age_s=0.1).condition == "partly_received"


def test_the_error_can_be_switched_off() -> None:
    """ros.consensus.open_faults: false leaves a warning."""
    result = Quorum(consensus={"open_faults": False}).after(60, matrix(A, B, C, not_received=UNSEEN))
    assert (result.level, result.condition) == (api.Level.WARN, "partly_received")


def test_the_result_contains_the_votes() -> None:
    """Of each node: verdict, and who votes alive and dead; for `/phm/consensus`."""
    result = evaluate(matrix(A, B, not_received=((A, B),)), topics=active_topic(C))
    assert result.votes == (
        api.NodeVotes("agent_1/a", "alive", ("agent_1/b", "PHM"), ()),
        api.NodeVotes("agent_1/b", "undecided", ("PHM",), ("agent_1/a",)),
        api.NodeVotes("agent_1/c", "alive", ("PHM",), ()),
    )
