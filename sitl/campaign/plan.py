"""The plan of a campaign, drawn from its seeds: which faults, on which agents, together with which others. Pure."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

SHAPES = ((1,), (2,), (1,), (1, 1), (2, 1), (1,), (3,), (1, 1, 1))
"""Faults of a trial on each of its agents, over and over: three of eight trials have two or three faults on one agent."""
Pair = tuple[str, str]


@dataclass(frozen=True)
class Class:
    """The properties of a fault that the plan needs. `kind`: what fails. `partners`: kinds of faults that may be on the
    same agent at the same time, because the end of each can be observed. `alone`: other agents are affected, too, so no
    fault is on them meanwhile. `rank`: of the faults on one agent, the lowest is injected first.
    """

    name: str
    kind: str
    partners: frozenset[str] = frozenset()
    alone: bool = False
    rank: int = 0


@dataclass(frozen=True)
class Draw:
    """One fault on one agent (1 to the number of agents)."""

    fault: str
    agent: int


@dataclass(frozen=True)
class TrialPlan:
    """`number` counts from 1 in each seed. Agents get their draws at the same time, those of one agent one after the other, in this order."""

    number: int
    draws: tuple[Draw, ...]

    @property
    def kind(self) -> str:
        return "single" if len(self.draws) == 1 else "compound"

    @property
    def together(self) -> int:
        """The largest number of faults on one agent."""
        return max(Counter(draw.agent for draw in self.draws).values(), default=0)

    @property
    def singly(self) -> list[Draw]:
        """The faults that are the only one of their agent."""
        on = Counter(draw.agent for draw in self.draws)
        return [draw for draw in self.draws if on[draw.agent] == 1]


def plan(
    seeds: Sequence[int], agents: int, trials: int, classes: Collection[Class], wanted: Sequence[Pair] = ()
) -> tuple[tuple[TrialPlan, ...], ...]:
    """The trials of each seed. Every choice takes a class that was drawn least often so far, over all seeds, and draws
    among those by the seed. The only fault of an agent is of a class that never was the only one, if there is any. So more
    seeds begin with the same trials.

    `wanted`: pairs of kinds that must be injected on one agent, in turn. Raises ValueError when there is nothing to draw
    from.
    """
    if agents < 1 or trials < 0:
        raise ValueError(
            f"a campaign needs 1 agent or more and no negative number of trials, not {agents} and {trials}"
        )
    if not classes:
        raise ValueError("a campaign needs at least one class of faults")
    drawer = _Drawer(sorted(classes, key=lambda each: each.name), wanted)
    return tuple(tuple(_trials(seed, agents, trials, drawer)) for seed in seeds)


def counts(plans: Collection[Sequence[TrialPlan]]) -> Counter[str]:
    """How often each fault is injected in all of them."""
    return Counter(draw.fault for trials in plans for trial in trials for draw in trial.draws)


def singly(plans: Collection[Sequence[TrialPlan]]) -> Counter[str]:
    """How often each fault is the only one of its agent."""
    return Counter(draw.fault for trials in plans for trial in trials for draw in trial.singly)


def trials_for(
    seeds: Sequence[int],
    agents: int,
    least: int,
    times: int,
    classes: Collection[Class],
    wanted: Sequence[Pair] = (),
    most: int = 200,
) -> int:
    """The number of trials of each seed, at least `least`, with which every class is injected so many `times` in all, once or
    more as the only fault of its agent."""
    for trials in range(least, most):
        plans = plan(seeds, agents, trials, classes, wanted)
        found, single = counts(plans), singly(plans)
        if all(found[each.name] >= times and single[each.name] >= min(times, 1) for each in classes):
            return trials
    raise ValueError(f"{most} trials of each seed do not inject each of {len(classes)} faults {times} times")


def fits(fault: Class, others: Sequence[Class]) -> bool:
    """Whether the fault may be injected on an agent together with these."""
    return all(fault.kind in each.partners and each.kind in fault.partners for each in others)


def _trials(seed: int, agents: int, trials: int, drawer: _Drawer) -> Iterator[TrialPlan]:
    rng = random.Random(f"phm-campaign/{seed}")
    victims = _Victims(rng, agents)
    for number in range(1, trials + 1):
        shape = SHAPES[(number - 1) % len(SHAPES)][:agents]
        taken: list[Class] = []
        draws: list[Draw] = []
        for size in shape:
            if any(each.alone for each in taken):
                break
            group = drawer.group(rng, size, taken, sole=len(shape) == 1)
            if not group and not taken:  # there are only faults that affect several agents
                group = drawer.group(rng, 1, (), sole=True)
            if not group:
                break
            agent = victims.next([draw.agent for draw in draws])
            draws += [Draw(each.name, agent) for each in sorted(group, key=lambda each: (each.rank, each.name))]
            taken += group
        yield TrialPlan(number, tuple(draws))


class _Drawer:
    """Draws the class that was drawn least often."""

    def __init__(self, classes: Sequence[Class], wanted: Sequence[Pair]) -> None:
        self._classes, self._wanted = classes, wanted
        self._drawn: Counter[str] = Counter()
        self._singly: set[str] = set()
        """Classes that were drawn as the only fault of an agent."""
        self._pairs: Counter[Pair] = Counter()
        self._groups = 0

    def group(self, rng: random.Random, size: int, taken: Sequence[Class], *, sole: bool) -> list[Class]:
        """Up to `size` faults for one agent. `sole`: no other agent gets any."""
        usable = [each for each in self._classes if each not in taken and (sole or not each.alone)]
        group = self._pair(rng, usable) if size > 1 else []
        first = [each for each in usable if each.name not in self._singly] if size == 1 else []
        while len(group) < size:
            more = self._next(
                rng,
                first or usable,
                lambda each: each not in group and fits(each, group) and (size == 1 or bool(each.partners)),
            ) or (None if group else self._next(rng, usable, lambda _: True))
            if more is None:
                break
            group.append(more)
        for each in group:
            self._drawn[each.name] += 1
        if len(group) == 1:
            self._singly.add(group[0].name)
        return group

    def _pair(self, rng: random.Random, usable: Sequence[Class]) -> list[Class]:
        """For every second group a wanted pair, that which was drawn least often; empty when none is possible."""
        self._groups += 1
        if sum(self._pairs.values()) >= self._groups / 2 + 1:
            return []
        for pair in sorted(self._wanted, key=lambda each: self._pairs[each]):
            first = self._next(rng, usable, partial(_leads, pair=pair, usable=usable))
            if first is not None:
                self._pairs[pair] += 1
                partner = self._next(rng, usable, partial(_completes, pair=pair, first=first))
                assert partner is not None  # `first` was chosen so
                return [first, partner]
        return []

    def _next(self, rng: random.Random, usable: Sequence[Class], wanted: Callable[[Class], bool]) -> Class | None:
        found = [each for each in usable if wanted(each)]
        least = min((self._drawn[each.name] for each in found), default=0)
        rarest = [each for each in found if self._drawn[each.name] == least]
        return rng.choice(rarest) if rarest else None


def _leads(fault: Class, pair: Pair, usable: Sequence[Class]) -> bool:
    return fault.kind == pair[0] and any(_completes(each, pair, fault) for each in usable)


def _completes(fault: Class, pair: Pair, first: Class) -> bool:
    return fault.kind == pair[1] and fault != first and fits(fault, [first])


class _Victims:
    """All agents in a random order, repeatedly: none is drawn twice in succession if there are two or more."""

    def __init__(self, rng: random.Random, agents: int) -> None:
        self._rng, self._agents = rng, agents
        self._left: list[int] = []
        self._last = 0

    def next(self, but: Collection[int]) -> int:
        """The next one that is none of these, fewer than all."""
        if not self._left:
            self._left = list(range(1, self._agents + 1))
            self._rng.shuffle(self._left)
            if self._left[0] == self._last and self._agents > 1:
                self._left.append(self._left.pop(0))
        free = [agent for agent in self._left if agent not in but]
        if not free:
            self._left += self._rng.sample(range(1, self._agents + 1), self._agents)
            free = [agent for agent in self._left if agent not in but]
        self._last = free[0]
        self._left.remove(free[0])
        return self._last
