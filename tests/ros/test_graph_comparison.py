"""A second participant shows what PHM's own one missed, which is not reported dead, and what it lists after its end."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable

import pytest

from phm.facts import CannotTell, RosFact
from phm.probes.ros.graph_comparison import (
    CALM_S,
    CONFIRM_S,
    CONFIRM_STALE_S,
    OPEN_S,
    REST_MOST_S,
    REST_S,
    GraphComparison,
    Known,
)
from tests.fakes.ros_bench import Bench, seen, until

TOPIC, NODE, OTHER = "/agent_1/topic_1", "/agent_1/node_1", "/agent_1/node_2"
ALL: Known = frozenset({(NODE,), (TOPIC, "publisher", NODE), (TOPIC, "subscriber", OTHER)})
NOTHING: Known = frozenset()
TICK_S = 0.25
FOUND_S = CALM_S + TICK_S + CONFIRM_S
"""The second participant is first polled one tick after it was opened."""


class Participant:
    """A participant that knows what the test sets."""

    def __init__(self, knows: Callable[[float], Known]) -> None:
        self._knows = knows
        self.open = True

    def known(self, now_s: float) -> Known:
        assert self.open
        return self._knows(now_s)

    def close(self) -> None:
        self.open = False


class World:
    """A first participant that is polled four times a second, and the second ones that were opened beside it."""

    def __init__(self, second: Callable[[float], Known]) -> None:
        self.opened: list[float] = []
        self.participants: list[Participant] = []
        self.now_s = 0.0
        self._second = second
        self.comparison = GraphComparison(self._open, self.now_s)

    def _open(self) -> Participant:
        self.opened.append(self.now_s)
        self.participants.append(Participant(self._second))
        return self.participants[-1]

    def run(self, until_s: float, known: Known, *, lacking: bool = False) -> list[tuple[float, list[str]]]:
        """When something was found to be missed or stale, and what."""
        found = []
        while self.now_s < until_s:
            if differences := self.comparison.update(self.now_s, known, lacking=lacking):
                found.append((self.now_s, [*differences.missed, *differences.stale]))
            self.now_s += TICK_S
        return found


def test_one_second_participant_is_opened_after_the_start() -> None:
    """A complete snapshot costs one second participant for some seconds."""
    world = World(lambda now_s: ALL)
    assert world.run(1000.0, ALL) == []
    assert world.opened == [CALM_S]
    assert not world.participants[0].open


def test_a_node_that_the_first_participant_missed_is_found() -> None:
    """The second one has known it for some seconds; then it is closed, and a pause follows."""
    world = World(lambda now_s: ALL)
    assert world.run(20.0, NOTHING, lacking=True) == [(FOUND_S, [NODE, TOPIC])]
    assert [participant.open for participant in world.participants] == [False]


def test_a_missing_endpoint_is_found_while_all_configured_nodes_are_listed() -> None:
    """A listed node may lack only its subscription."""
    world = World(lambda now_s: ALL)
    assert world.run(20.0, ALL - {(TOPIC, "subscriber", OTHER)}) == [(FOUND_S, [TOPIC])]


def test_a_late_entity_was_not_missed() -> None:
    """The second participant may be faster, by less than the time after which its view counts."""
    world = World(lambda now_s: ALL if now_s > CALM_S + 1.0 else NOTHING)
    found = world.run(CALM_S + 1.0 + CONFIRM_S, NOTHING)
    assert found + world.run(60.0, ALL) == []


def test_a_departed_node_is_looked_up_with_a_second_participant() -> None:
    """Its lease may have expired for PHM alone, and it may return incompletely."""
    world = World(lambda now_s: ALL)
    world.run(100.0, ALL)
    assert world.run(120.0, ALL - {(NODE,)}) == [(100.0 + FOUND_S, [NODE])]


def test_a_missing_node_is_looked_up_less_and_less_often() -> None:
    """A configured node that is switched off."""
    world = World(lambda now_s: NOTHING)
    assert world.run(5000.0, NOTHING, lacking=True) == []
    assert all(not participant.open for participant in world.participants)
    pauses = [later - earlier - OPEN_S for earlier, later in zip(world.opened, world.opened[1:], strict=False)]
    assert pauses[:7] == [*(REST_S * 2**turn for turn in range(1, 6)), REST_MOST_S, REST_MOST_S]


def leaves_every(world: World, period_s: int, until_s: int) -> None:
    """A short-lived node, such as a command line tool in a health check, appears and disappears."""
    for at_s in range(int(world.now_s), until_s, period_s):
        world.run(at_s + period_s - 2.0, ALL)
        world.run(at_s + period_s, ALL | {("/tool",)})


def test_a_recurring_short_lived_node_is_looked_up_less_and_less_often() -> None:
    """A health check that joins the graph every 20 s must not keep a second participant open."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    assert len([at_s for at_s in world.opened if at_s >= 3600.0]) <= 3600.0 / REST_MOST_S + 1


def test_a_rare_departure_is_looked_up_immediately() -> None:
    """After a period without departures the pause between two lookups is short again."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    world.run(12000.0, ALL)
    assert world.run(12020.0, ALL - {(NODE,)}) == [(12000.0 + FOUND_S, [NODE])]


def test_a_configured_node_is_looked_up_soon_whatever_else_leaves() -> None:
    """A configured node does not wait for the end of a pause caused by health checks."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    assert world.run(7230.0, ALL - {(NODE,)}, lacking=True)


def test_a_new_participant_that_also_misses_it_is_replaced_after_a_pause() -> None:
    """A lasting overload must not replace the participant repeatedly."""
    world = World(lambda now_s: ALL)
    (first,) = world.run(20.0, NOTHING)
    world.comparison.renewed(20.0)
    (second,) = world.run(60.0, NOTHING)
    assert second[0] - first[0] == 2 * REST_S + TICK_S + CONFIRM_S


def test_the_first_participant_is_kept_when_no_second_can_be_opened() -> None:
    """At a limit of threads or participants nothing is raised, and PHM tries again after a pause."""
    tried: list[float] = []

    def refuse() -> Participant:
        tried.append(now_s)
        raise RuntimeError("no more participants")

    comparison = GraphComparison(refuse, 0.0)
    for now_s in map(float, range(200)):
        assert comparison.update(now_s, NOTHING, lacking=True) is None
    assert tried == [CALM_S, CALM_S + 2 * REST_S, CALM_S + 6 * REST_S]


BEHIND: Known = frozenset({(NODE,)})
"""What is left of a node whose last announcement was processed after its end: no endpoint."""
STALE_S = CALM_S + TICK_S + CONFIRM_STALE_S


def test_a_node_that_only_the_first_participant_lists_is_found() -> None:
    """It ended: the second participant knows everything else for some seconds, and never the node."""
    rest = ALL - {(NODE,), (TOPIC, "publisher", NODE)}
    world = World(lambda now_s: rest)
    assert world.run(20.0, rest | BEHIND) == [(STALE_S, [NODE])]
    assert [participant.open for participant in world.participants] == [False]


def test_the_only_node_is_found_when_it_is_stale() -> None:
    """Nothing else exists that the second participant could know."""
    world = World(lambda now_s: NOTHING)
    assert world.run(20.0, BEHIND) == [(STALE_S, [NODE])]


def test_a_node_with_an_endpoint_is_not_stale() -> None:
    """The endpoint proves that the middleware still considers the node's process alive."""
    world = World(lambda now_s: NOTHING)
    assert world.run(200.0, ALL) == []


def test_a_second_participant_that_knows_less_proves_nothing() -> None:
    """On an overloaded machine it discovers the others late, and may discover this node even later."""
    world = World(lambda now_s: NOTHING)
    assert world.run(200.0, frozenset({(NODE,), (OTHER,), (TOPIC, "subscriber", OTHER)})) == []


def test_a_node_that_the_second_participant_discovers_late_is_not_stale() -> None:
    """The time counts from the moment when it knows everything else."""
    late_s = CALM_S + CONFIRM_STALE_S
    world = World(lambda now_s: BEHIND if now_s > late_s else NOTHING)
    assert world.run(200.0, BEHIND) == []


BLIND = (
    "import phm.probes.ros.graph as g; plain = g.GraphReader.poll; first = []\n"
    "def poll(self, now_s, *, notified=False):\n"
    "    first.append(self) if not first else None\n"
    "    changed = plain(self, now_s, notified=notified)\n"
    "    if self is first[0]:\n"
    "        self.nodes, self.publishers = {}, dict.fromkeys(self.publishers, ())\n"
    "    return changed\n"
    "g.GraphReader.poll = poll; from phm.probes.ros.child import main; raise SystemExit(main())"
)
"""A child whose first participant permanently misses all nodes and publishers."""


def test_a_child_that_permanently_missed_a_node_gets_a_new_participant(bench: Bench) -> None:
    """The node is listed by name and its rate is measured, without another process."""
    bench.node("node_1", "--publish", "topic_1:10", "--no-beacon")
    probe = bench.probe([{"name": TOPIC, "rate": 10}], nodes=[{"name": NODE}], command=(sys.executable, "-c", BLIND))
    first = seen(probe, lambda fact: fact.topics and probe.pid, "the child")

    def complete(fact: RosFact) -> bool:
        topic = fact.topics[TOPIC]
        return NODE in fact.nodes and bool(topic.publishers and topic.rate and topic.rate.hz)

    seen(probe, complete, "the node and its rate")
    assert (probe.pid, probe.restarts) == (first, 0)
    assert [note for note in bench.notes if "a new participant" in note and NODE in note]


@pytest.mark.one_distribution
def test_a_node_that_stays_listed_after_its_end_is_removed_with_a_new_participant(bench: Bench) -> None:
    """The last announcement of the node comes, as by that race, from a participant that no longer exists."""
    node = bench.node("node_1", "--publish", "topic_1:10", "--no-beacon")
    probe = bench.probe([{"name": TOPIC}], nodes=[{"name": NODE}])
    seen(probe, lambda fact: fact.topics[TOPIC].publishers, "the publisher")
    forger = bench.script("ros_discovery_forger.py", "0", "", NODE)
    seen(probe, lambda fact: fact.nodes.get(NODE) == 2, "the announcement")
    facts: list[RosFact] = []

    def changed() -> None:
        """PHM corrects its picture after ten seconds: a test that polls may get no CPU in all of them."""
        with contextlib.suppress(CannotTell):
            facts.append(probe.snapshot())

    bench.on_change = changed
    forger.kill()
    node.kill()
    until(
        lambda: any(not fact.topics[TOPIC].publishers and NODE in fact.nodes for fact in facts),
        "a node without endpoints",
    )
    seen(probe, lambda fact: NODE not in fact.nodes, "its absence", limit_s=120.0)
    assert [note for note in bench.notes if f"still listed {NODE}, which has ended" in note]
