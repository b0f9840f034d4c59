"""Consensus of the nodes about each other: who hears whom, what the majority says, who dissents, where it is split. Pure.

An observer is a process that PHM hears, through its beacon, or PHM itself. The nodes of one process hear with the same
ears, so they count once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from phm import api

PHM = "PHM"
SILENT_PERIODS, SILENT_S = 3.0, 0.5
"""A beacon that misses this many beats, and for no less than this time, is silent."""
HUNG_S = 5.0
"""An executor that has not turned for this long hangs."""
MET_S = 10.0
"""Two nodes that have both lived this long should have met; before, not knowing each other means nothing."""


class Verdict(Enum):
    """What the observers say about a node, by strict majority of those who have an opinion."""

    ALIVE = "alive"
    HUNG = "hung"
    """Alive, and its executor does not turn."""
    DEAD = "dead"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Opinion:
    """heard_by, unheard_by: observers, by the name of their first node, PHM last."""

    node: str
    verdict: Verdict
    heard_by: tuple[str, ...] = ()
    unheard_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Agreement:
    """opinions: of all nodes asked about. observers: who took part, PHM last. sides: more than one when the living nodes
    have fallen apart into groups of which none hears another.
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
    def dissents(self) -> tuple[Opinion, ...]:
        """Nodes about which the observers differ, but for those that the split explains."""
        return tuple(item for item in self.opinions if item.heard_by and item.unheard_by and not self._explained(item))

    def _explained(self, opinion: Opinion) -> bool:
        if not self.split or PHM in opinion.unheard_by:
            return False
        own = next((side for side in self.sides if opinion.node in side), ())
        return not any(observer in own for observer in opinion.unheard_by)


def agree(beacons: Mapping[str, api.BeaconFact], others: Mapping[str, bool], late_s: float = 0.0) -> Agreement:
    """The consensus, by full names of nodes.

    beacons: of the nodes that have one. others: those without, and whether PHM hears them in another way: nobody but PHM
    can tell of them. late_s: how old the picture is; while PHM itself is late, nobody was heard, and that is no silence.
    """
    heard = {node: not silent(fact, late_s) for node, fact in beacons.items()}
    processes: dict[str, list[str]] = {}
    for node, fact in sorted(beacons.items()):
        if heard[node]:
            processes.setdefault(fact.witness or node, []).append(node)
    ears = {nodes[0]: nodes for nodes in processes.values()}
    opinions = [_opinion(node, beacons, heard, ears) for node in sorted(beacons)]
    opinions += [_alone(node, hears) for node, hears in sorted(others.items())]
    return Agreement(tuple(opinions), (*ears, PHM), _sides(ears, opinions))


def silent(fact: api.BeaconFact, late_s: float = 0.0) -> bool:
    """Whether PHM does not hear the node."""
    return max(0.0, fact.silent_s - late_s) > max(SILENT_PERIODS * fact.period_s, SILENT_S)


def _opinion(
    node: str, beacons: Mapping[str, api.BeaconFact], heard: Mapping[str, bool], ears: Mapping[str, list[str]]
) -> Opinion:
    votes = {
        observer: _hears(beacons[observer], beacons[node], node) for observer in ears if node not in ears[observer]
    }
    votes[PHM] = heard[node]
    yes = tuple(observer for observer, vote in votes.items() if vote is True)
    no = tuple(observer for observer, vote in votes.items() if vote is False)
    if len(yes) > len(no):
        verdict = Verdict.HUNG if beacons[node].late_s > HUNG_S else Verdict.ALIVE
    else:
        verdict = Verdict.UNDECIDED if len(yes) == len(no) else Verdict.DEAD
    return Opinion(node, verdict, yes, no)


def _alone(node: str, hears: bool) -> Opinion:
    """Not to be heard by PHM alone is no proof of anything."""
    return Opinion(node, Verdict.ALIVE, (PHM,)) if hears else Opinion(node, Verdict.UNDECIDED, (), (PHM,))


def _hears(observer: api.BeaconFact, other: api.BeaconFact, node: str) -> bool | None:
    """None: no opinion, as they have not had the time to meet."""
    view = observer.views.get(node)
    if view is not None:
        return view.alive
    lived_s = min(fact.beats * fact.period_s for fact in (observer, other))
    return False if lived_s >= MET_S else None


def _sides(ears: Mapping[str, list[str]], opinions: Iterable[Opinion]) -> tuple[tuple[str, ...], ...]:
    """Groups of nodes that hear each other, directly or through others. One direction will do: the other is dissent."""
    deaf = {(observer, opinion.node) for opinion in opinions for observer in opinion.unheard_by}

    def apart(one: str, other: str) -> bool:
        return all(any((here, node) in deaf for node in ears[there]) for here, there in ((one, other), (other, one)))

    left, sides = list(ears), []
    while left:
        side, fresh = [left[0]], [left.pop(0)]
        while fresh:
            near = fresh.pop()
            joined = [other for other in left if not apart(near, other)]
            left = [other for other in left if other not in joined]
            side += joined
            fresh += joined
        sides.append(tuple(sorted(node for observer in side for node in ears[observer])))
    return tuple(sides)
