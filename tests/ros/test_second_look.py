"""What PHM's own participant has missed for good is seen with a second one, and is not taken for dead."""

from __future__ import annotations

import sys
from collections.abc import Callable

from phm.facts import RosFact
from phm.probes.ros.second_look import CALM_S, CONFIRM_S, OPEN_S, REST_MOST_S, REST_S, Known, SecondLook
from tests.fakes.ros_bench import Bench, seen

TOPIC, NODE, OTHER = "/agent_1/topic_1", "/agent_1/node_1", "/agent_1/node_2"
ALL: Known = frozenset({(NODE,), (TOPIC, "publisher", NODE), (TOPIC, "subscriber", OTHER)})
NOTHING: Known = frozenset()
TICK_S = 0.25
FOUND_S = CALM_S + TICK_S + CONFIRM_S
"""The second participant is first asked a tick after it was opened."""


class Participant:
    """Knows what the test says."""

    def __init__(self, knows: Callable[[float], Known]) -> None:
        self._knows = knows
        self.open = True

    def known(self, now_s: float) -> Known:
        assert self.open
        return self._knows(now_s)

    def close(self) -> None:
        self.open = False


class World:
    """A first participant that is asked four times a second, and the second ones that were opened beside it."""

    def __init__(self, second: Callable[[float], Known]) -> None:
        self.opened: list[float] = []
        self.scouts: list[Participant] = []
        self.now_s = 0.0
        self._second = second
        self.look = SecondLook(self._open, self.now_s)

    def _open(self) -> Participant:
        self.opened.append(self.now_s)
        self.scouts.append(Participant(self._second))
        return self.scouts[-1]

    def run(self, until_s: float, known: Known, *, lacking: bool = False) -> list[tuple[float, list[str]]]:
        """When something was found to be missed, and what."""
        found = []
        while self.now_s < until_s:
            if missed := self.look.look(self.now_s, known, lacking=lacking):
                found.append((self.now_s, list(missed)))
            self.now_s += TICK_S
        return found


def test_after_its_start_it_looks_once_while_nothing_is_missing() -> None:
    """A picture that is whole costs one second participant, for some seconds."""
    world = World(lambda now_s: ALL)
    assert world.run(1000.0, ALL) == []
    assert world.opened == [CALM_S]
    assert not world.scouts[0].open


def test_a_node_that_the_first_participant_missed_is_found() -> None:
    """The second one has known it for some seconds; then it is closed, and there is a rest."""
    world = World(lambda now_s: ALL)
    assert world.run(20.0, NOTHING, lacking=True) == [(FOUND_S, [NODE, TOPIC])]
    assert [scout.open for scout in world.scouts] == [False]


def test_an_end_that_is_missing_is_found_though_nothing_that_is_configured_lacks() -> None:
    """A node that is listed may lack its subscription alone."""
    world = World(lambda now_s: ALL)
    assert world.run(20.0, ALL - {(TOPIC, "subscriber", OTHER)}) == [(FOUND_S, [TOPIC])]


def test_what_comes_late_has_not_been_missed() -> None:
    """The second participant may be the quicker one, by less than it takes to be believed."""
    world = World(lambda now_s: ALL if now_s > CALM_S + 1.0 else NOTHING)
    found = world.run(CALM_S + 1.0 + CONFIRM_S, NOTHING)
    assert found + world.run(60.0, ALL) == []


def test_what_left_is_looked_for_with_a_second_participant() -> None:
    """It may be the lease that ran out for PHM alone: what comes back of it may not be all."""
    world = World(lambda now_s: ALL)
    world.run(100.0, ALL)
    assert world.run(120.0, ALL - {(NODE,)}) == [(100.0 + FOUND_S, [NODE])]


def test_what_is_not_there_is_looked_for_more_and_more_rarely() -> None:
    """A node that is configured and switched off."""
    world = World(lambda now_s: NOTHING)
    assert world.run(5000.0, NOTHING, lacking=True) == []
    assert all(not scout.open for scout in world.scouts)
    pauses = [later - earlier - OPEN_S for earlier, later in zip(world.opened, world.opened[1:], strict=False)]
    assert pauses[:7] == [*(REST_S * 2**turn for turn in range(1, 6)), REST_MOST_S, REST_MOST_S]


def leaves_every(world: World, period_s: int, until_s: int) -> None:
    """A short node, such as a command line tool in a health check, comes and goes."""
    for at_s in range(int(world.now_s), until_s, period_s):
        world.run(at_s + period_s - 2.0, ALL)
        world.run(at_s + period_s, ALL | {("/tool",)})


def test_what_leaves_again_and_again_is_looked_for_more_and_more_rarely() -> None:
    """A health check that joins the graph every 20 s must not keep a second participant in it."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    assert len([at_s for at_s in world.opened if at_s >= 3600.0]) <= 3600.0 / REST_MOST_S + 1


def test_what_leaves_seldom_is_looked_for_at_once() -> None:
    """After a calm time the pause between two looks is short again."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    world.run(12000.0, ALL)
    assert world.run(12020.0, ALL - {(NODE,)}) == [(12000.0 + FOUND_S, [NODE])]


def test_what_is_configured_is_looked_for_soon_whatever_else_leaves() -> None:
    """A node that is wanted does not wait out the pause that health checks brought about."""
    world = World(lambda now_s: ALL)
    leaves_every(world, 20, 7200)
    assert world.run(7230.0, ALL - {(NODE,)}, lacking=True)


def test_a_new_participant_that_misses_it_too_is_replaced_after_a_rest() -> None:
    """An overload that lasts must not have the participant replaced again and again."""
    world = World(lambda now_s: ALL)
    (first,) = world.run(20.0, NOTHING)
    world.look.renewed(20.0)
    (second,) = world.run(60.0, NOTHING)
    assert second[0] - first[0] == 2 * REST_S + TICK_S + CONFIRM_S


def test_where_no_second_participant_can_be_had_the_first_has_to_do() -> None:
    """At a limit of threads or participants nothing is raised, and it is tried again after a rest."""
    tried: list[float] = []

    def refuse() -> Participant:
        tried.append(now_s)
        raise RuntimeError("no more participants")

    look = SecondLook(refuse, 0.0)
    for now_s in map(float, range(200)):
        assert look.look(now_s, NOTHING, lacking=True) == ()
    assert tried == [CALM_S, CALM_S + 2 * REST_S, CALM_S + 6 * REST_S]


DEAF = (
    "import phm.probes.ros.graph as g; plain = g.GraphReader.look; first = []\n"
    "def look(self, now_s, *, notified=False):\n"
    "    first.append(self) if not first else None\n"
    "    changed = plain(self, now_s, notified=notified)\n"
    "    if self is first[0]:\n"
    "        self.nodes, self.publishers = {}, dict.fromkeys(self.publishers, ())\n"
    "    return changed\n"
    "g.GraphReader.look = look; from phm.probes.ros.child import main; raise SystemExit(main())"
)
"""A child whose first participant misses all nodes and publishers for good."""


def test_a_child_that_missed_a_node_for_good_gets_a_new_participant(bench: Bench) -> None:
    """The node is listed by its name and its rate is measured, without another process."""
    bench.node("node_1", "--publish", "topic_1:10", "--no-beacon")
    probe = bench.probe([{"name": TOPIC, "rate": 10}], nodes=[{"name": NODE}], command=(sys.executable, "-c", DEAF))
    first = seen(probe, lambda fact: fact.topics and probe.pid, "the child")

    def whole(fact: RosFact) -> bool:
        topic = fact.topics[TOPIC]
        return NODE in fact.nodes and bool(topic.publishers and topic.rate and topic.rate.hz)

    seen(probe, whole, "the node and its rate")
    assert (probe.pid, probe.restarts) == (first, 0)
    assert [note for note in bench.notes if "a new participant" in note and NODE in note]
