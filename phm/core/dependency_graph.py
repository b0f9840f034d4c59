"""The dependency graph of the units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter


class DependencyCycle(Exception):
    """Units that depend on each other; `loop` lists them in order, the first again at the end."""

    def __init__(self, loop: list[str]) -> None:
        super().__init__(f"dependency cycle: {' -> '.join(loop)}")
        self.loop = loop


class DependencyGraph:
    """Transitive dependencies in both directions. Immutable; dependencies on unknown units are ignored.

    `upstream` lists the dependencies of a unit, causes first: the first failing one is the root cause.
    """

    def __init__(self, needs: Mapping[str, Iterable[str]]) -> None:
        direct = {
            unit: tuple(need for need in wanted if need in needs and need != unit) for unit, wanted in needs.items()
        }
        try:
            order = tuple(TopologicalSorter(direct).static_order())
        except CycleError as error:
            raise DependencyCycle(list(reversed(error.args[1]))) from error
        place = {unit: index for index, unit in enumerate(order)}
        above: dict[str, frozenset[str]] = {}
        for unit in order:
            above[unit] = frozenset(direct[unit]).union(*(above[need] for need in direct[unit]))
        self._upstream = {unit: tuple(sorted(units, key=place.__getitem__)) for unit, units in above.items()}
        below: dict[str, list[str]] = {unit: [] for unit in order}
        for unit in order:
            for need in self._upstream[unit]:
                below[need].append(unit)
        self._downstream = {unit: tuple(units) for unit, units in below.items()}

    def upstream(self, unit: str) -> tuple[str, ...]:
        return self._upstream[unit]

    def downstream(self, unit: str) -> tuple[str, ...]:
        return self._downstream[unit]
