"""Consensus of the nodes about each other: which nodes receive each other, the majority's verdict, disagreements and splits. Pure.

An observer is a process whose beacon PHM receives, or PHM itself. The nodes of one process receive the same data, so they count once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from phm import api
from phm_checks._ros_facts import beacon_silent

PHM = "PHM"
HUNG_S = 5.0
"""An executor that has not run for this long is hung."""
MET_S = 10.0
"""Two nodes that have both run for this long should have discovered each other; before that, not knowing each other means nothing."""


class Verdict(Enum):
    """The observers' verdict on a node, by strict majority of those with an opinion."""

    ALIVE = "alive"
    HUNG = "hung"
    """Alive, but its executor does not run."""
    DEAD = "dead"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Opinion:
    """The two tuples contain the observers that receive the node and those that do not, by the name of their first node, PHM last."""

    node: str
    verdict: Verdict
    received_by: tuple[str, ...] = ()
    not_received_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Agreement:
    """opinions: on all evaluated nodes. observers: all participants, PHM last. sides: more than one if the living nodes
    are split into groups that do not receive each other.
    """

    opinions: tuple[Opinion, ...]
    observers: tuple[str, ...]
    sides: tuple[tuple[str, ...], ...] = ()

    @property
    def split(self) -> bool:
        return len(self.sides) > 1

    @property
    def alive(self) -> tuple[str, ...]:
        return tuple(item.node for item in self.opinions if item.verdict in (Verdict.ALIVE, Verdict.HUNG))

    @property
    def disagreements(self) -> tuple[Opinion, ...]:
        """Nodes on which the observers disagree, except those that the split explains."""
        return tuple(
            item for item in self.opinions if item.received_by and item.not_received_by and not self._explained(item)
        )

    def _explained(self, opinion: Opinion) -> bool:
        if not self.split or PHM in opinion.not_received_by:
            return False
        own = next((side for side in self.sides if opinion.node in side), ())
        return not any(observer in own for observer in opinion.not_received_by)


def agree(beacons: Mapping[str, api.BeaconFact], others: Mapping[str, bool], late_s: float = 0.0) -> Agreement:
    """Determine the consensus, by full node names.

    beacons: of the nodes that have one. others: the nodes without one, and whether PHM receives data from them in another way: only
    PHM can observe them. late_s: age of the snapshot; while PHM itself is late, it receives nothing from any node, and that does not
    count as silence.
    """
    received = {node: not beacon_silent(fact, late_s) for node, fact in beacons.items()}
    processes: dict[str, list[str]] = {}
    for node, fact in sorted(beacons.items()):
        if received[node]:
            processes.setdefault(fact.witness or node, []).append(node)
    nodes_of = {nodes[0]: nodes for nodes in processes.values()}
    opinions = [_opinion(node, beacons, received, nodes_of) for node in sorted(beacons)]
    opinions += [_alone(node, receives) for node, receives in sorted(others.items())]
    return Agreement(tuple(opinions), (*nodes_of, PHM), _sides(nodes_of, opinions))


def _opinion(
    node: str, beacons: Mapping[str, api.BeaconFact], received: Mapping[str, bool], nodes_of: Mapping[str, list[str]]
) -> Opinion:
    votes = {
        observer: receives_other(beacons[observer], beacons[node], node)
        for observer in nodes_of
        if node not in nodes_of[observer]
    }
    votes[PHM] = received[node]
    yes = tuple(observer for observer, vote in votes.items() if vote is True)
    no = tuple(observer for observer, vote in votes.items() if vote is False)
    if len(yes) > len(no):
        verdict = Verdict.HUNG if beacons[node].late_s > HUNG_S else Verdict.ALIVE
    else:
        verdict = Verdict.UNDECIDED if len(yes) == len(no) else Verdict.DEAD
    return Opinion(node, verdict, yes, no)


def _alone(node: str, receives: bool) -> Opinion:
    """The opinion on a node that only PHM observes: if PHM alone does not receive it, that proves nothing."""
    return Opinion(node, Verdict.ALIVE, (PHM,)) if receives else Opinion(node, Verdict.UNDECIDED, (), (PHM,))


def receives_other(observer: api.BeaconFact, other: api.BeaconFact, node: str) -> bool | None:
    """Whether the observer receives the other node, `node`; None: no opinion, as they have not had enough time to discover each other, or
    its list of neighbours has no space for the node."""
    view = observer.views.get(node)
    if view is not None:
        return view.alive
    if observer.full:
        return None
    uptime_s = min(fact.heartbeats * fact.period_s for fact in (observer, other))
    return False if uptime_s >= MET_S else None


def _sides(nodes_of: Mapping[str, list[str]], opinions: Iterable[Opinion]) -> tuple[tuple[str, ...], ...]:
    """Groups of nodes that receive each other, directly or through others. One direction is enough: a failure of the other is a disagreement."""
    not_received = {(observer, opinion.node) for opinion in opinions for observer in opinion.not_received_by}

    def apart(one: str, other: str) -> bool:
        return all(
            any((here, node) in not_received for node in nodes_of[there])
            for here, there in ((one, other), (other, one))
        )

    left, sides = list(nodes_of), []
    while left:
        side, fresh = [left[0]], [left.pop(0)]
        while fresh:
            current = fresh.pop()
            joined = [other for other in left if not apart(current, other)]
            left = [other for other in left if other not in joined]
            side += joined
            fresh += joined
        sides.append(tuple(sorted(node for observer in side for node in nodes_of[observer])))
    return tuple(sides)
