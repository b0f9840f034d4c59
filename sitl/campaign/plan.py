"""What a campaign does, drawn from a seed: which faults, on which agents, alone or together. Pure."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, islice

SIZES = (1, 2, 1, 3)
"""Faults at once in the trials, over and over: every second trial is a single fault, the others are compound."""


@dataclass(frozen=True)
class Class:
    """What the plan must know of a fault. `group`: faults of one group on one agent hide or heal each other, so that
    they never come together. `whole`: nothing else comes on its agent, since PHM there sees or says nothing meanwhile.
    `alone`: it concerns more than one agent, and nothing else comes at all."""

    name: str
    layer: str
    group: str
    whole: bool = False
    alone: bool = False


@dataclass(frozen=True)
class Draw:
    """One fault on one agent (1 to the number of agents)."""

    fault: str
    agent: int


@dataclass(frozen=True)
class TrialPlan:
    """`number` counts from 1. All draws are injected in the same moment."""

    number: int
    draws: tuple[Draw, ...]

    @property
    def kind(self) -> str:
        return "single" if len(self.draws) == 1 else "compound"


def plan(seed: int, agents: int, trials: int, classes: Collection[Class]) -> tuple[TrialPlan, ...]:
    """The first `trials` trials of a seed. More trials of the same seed begin with the same ones.

    Each layer's classes come in a random order, the layers take turns, and no class comes again before all others of its
    layer have; agents take turns likewise. Raises ValueError when there is nothing to draw from.
    """
    if agents < 1 or trials < 0:
        raise ValueError(
            f"a campaign needs 1 agent or more and no negative number of trials, not {agents} and {trials}"
        )
    if not classes:
        raise ValueError("a campaign needs at least one class of faults")
    rng = random.Random(f"phm-campaign/{seed}")
    return tuple(islice(_trials(rng, agents, sorted(classes, key=lambda each: each.name)), trials))


def _trials(rng: random.Random, agents: int, classes: Sequence[Class]) -> Iterator[TrialPlan]:
    faults, victims = _Faults(rng, classes), _Victims(rng, agents)
    for number in count(1):
        taken: list[tuple[Class, int]] = []
        size = SIZES[(number - 1) % len(SIZES)]
        for _ in range(size):
            agent = victims.next()
            fault = None
            if size > 1 and not taken:
                fault = faults.next(_sociable)
            fault = fault or faults.next(partial(fits, agent=agent, taken=tuple(taken)))
            if fault is None:
                break
            taken.append((fault, agent))
        yield TrialPlan(number, tuple(Draw(fault.name, agent) for fault, agent in taken))


def fits(fault: Class, agent: int, taken: Sequence[tuple[Class, int]]) -> bool:
    """Whether the fault can come with those that are taken already."""
    if not taken:
        return True
    if fault.alone or any(each.alone for each, _ in taken):
        return False
    on_board = [each for each, victim in taken if victim == agent]
    return not any(fault.whole or each.whole or each.group == fault.group for each in on_board)


def _sociable(fault: Class) -> bool:
    return not fault.alone


class _Faults:
    """A shuffled bag for each layer; the layers take turns."""

    def __init__(self, rng: random.Random, classes: Sequence[Class]) -> None:
        self._rng = rng
        self._of: dict[str, list[Class]] = {}
        for each in classes:
            self._of.setdefault(each.layer, []).append(each)
        self._bags: dict[str, list[Class]] = {layer: [] for layer in self._of}
        layers = list(self._of)
        rng.shuffle(layers)
        self._turns = deque(layers)

    def next(self, wanted: Callable[[Class], bool]) -> Class | None:
        """The next class that is wanted; its layer goes to the end of the row. None when no layer has one in its bag."""
        for layer in tuple(self._turns):
            bag = self._bags[layer]
            if not bag:
                bag.extend(self._of[layer])
                self._rng.shuffle(bag)
            for place, each in enumerate(bag):
                if wanted(each):
                    self._turns.remove(layer)
                    self._turns.append(layer)
                    return bag.pop(place)
        return None


class _Victims:
    """All agents in a random order, then again in another: none comes twice in a row where there are two or more."""

    def __init__(self, rng: random.Random, agents: int) -> None:
        self._rng, self._agents = rng, agents
        self._left: list[int] = []
        self._last = 0

    def next(self) -> int:
        if not self._left:
            self._left = list(range(1, self._agents + 1))
            self._rng.shuffle(self._left)
            if self._left[0] == self._last and self._agents > 1:
                self._left.append(self._left.pop(0))
        self._last = self._left.pop(0)
        return self._last
