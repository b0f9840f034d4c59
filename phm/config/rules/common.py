"""What several rules need: keys and paths, uniqueness, order, and paths in a graph of names."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterable, Mapping

from phm.config.node import ConfigNode
from phm.config.problems import shown, unknown
from phm.core.message_fields import UnknownField
from phm.core.settings import ContainerSettings


def without_slash(name: str) -> str:
    """A ROS name without its first slash: both forms name the same node."""
    return name.lstrip("/")


def same_path(path: str) -> str:
    """`/a//b/` and `/a/b` are one file."""
    return posixpath.normpath(path).replace("//", "/")


def container_key(container: ConfigNode) -> str:
    """As `ContainerSettings.key`, of an entry that may be invalid elsewhere."""
    name, label, alias = (container.get(part).text or None for part in ("name", "label", "alias"))
    return ContainerSettings.model_construct(name=name, label=label, alias=alias).key


def report_duplicates(what: str, places: Iterable[tuple[str, ConfigNode]]) -> None:
    """Add a problem for each name that is defined twice, with the line of the first."""
    first: dict[str, ConfigNode] = {}
    for name, place in places:
        if name in first:
            place.add_problem(f"{what} {shown(name)} is defined twice, first in line {first[name].line}: keep one")
        elif name:
            first[name] = place


def configured(place: ConfigNode, known: Mapping[str, ConfigNode]) -> bool:
    """Whether the text is the key of a container in `known`; adds a problem when not."""
    real = {entry.get("name").text: key for key, entry in known.items()}
    if place.text in known:
        return True
    if place.text in real:
        place.add_problem(f"container {shown(place.text)} has the alias {shown(real[place.text])}: write that")
    elif known:
        place.add_problem(unknown("container", place.text, known))
    else:
        place.add_problem(f"unknown container {shown(place.text)}, none is configured: add it to 'containers'")
    return False


def in_order(low: ConfigNode, high: ConfigNode, kind: object, defaults: tuple[float, float]) -> None:
    """Add a problem at the key that is in the file when `low` is above `high`."""
    small, big = low.quantity(kind, defaults[0]), high.quantity(kind, defaults[1])
    if small is None or big is None or small <= big:
        return
    if low.given:
        low.add_problem(f"is {small:g}, above {high.path[-1]!r} which is {big:g}: allowed is {big:g} or less")
    else:
        high.add_problem(f"is {big:g}, below {low.path[-1]!r} which is {small:g}: allowed is {small:g} or more")


def demand_field_of_type(demand: Callable[[str, str], object], kind: str, place: ConfigNode, name: str) -> None:
    """Add a problem if the message type has no such field. demand: raises UnknownField for a type and a field."""
    try:
        demand(kind, name)
    except UnknownField as error:
        place.add_problem(str(error))


def shortest_path(graph: dict[str, set[str]], start: str, end: str) -> list[str] | None:
    """The shortest path from `start` to `end`, both included, or None."""
    ways = {start: [start]}
    queue = [start]
    for name in queue:
        if name == end:
            return ways[name]
        for need in sorted(graph.get(name, ())):
            if need not in ways:
                ways[need] = [*ways[name], need]
                queue.append(need)
    return None
