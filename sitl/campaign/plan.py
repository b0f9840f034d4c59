"""The plan of a campaign, drawn from a seed: which faults, on which agents, single or compound. Pure."""

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
    """The properties of a fault that the plan needs. `group`: faults of one group on one agent hide or resolve each
    other, so they are never combined. `whole`: no other fault is combined on its agent, since PHM there detects or
    reports nothing meanwhile. `alone`: it affects more than one agent, and is never combined.
    """

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
    """`number` counts from 1. All draws are injected at the same time."""

    number: int
    draws: tuple[Draw, ...]

    @property
    def kind(self) -> str:
        return "single" if len(self.draws) == 1 else "compound"


def plan(seed: int, agents: int, trials: int, classes: Collection[Class]) -> tuple[TrialPlan, ...]:
    """The first `trials` trials of a seed. More trials of the same seed begin with the same ones.

    Each layer's classes come in a random order, the layers alternate, and no class is repeated before all others of its
    layer were drawn; agents alternate likewise. Raises ValueError when there is nothing to draw from.
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
    """Whether the fault can be combined with those already drawn."""
    if not taken:
        return True
    if fault.alone or any(each.alone for each, _ in taken):
        return False
    on_board = [each for each, victim in taken if victim == agent]
    return not any(fault.whole or each.whole or each.group == fault.group for each in on_board)


def _sociable(fault: Class) -> bool:
    return not fault.alone


class _Faults:
    """A shuffled bag for each layer; the layers alternate."""

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
        """The next suitable class; its layer moves to the end of the queue. None when no layer has one in its bag."""
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
    """All agents in a random order, repeatedly: none is drawn twice in succession if there are two or more."""

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
