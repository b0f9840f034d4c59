"""Rules that need the installed checks and actions: their names, and dependency cycles."""

from __future__ import annotations

from collections.abc import Iterable

from phm.config.node import ConfigNode
from phm.config.problems import shown, unknown
from phm.config.rules.common import shortest_path


def names_of_checks(root: ConfigNode, known: Iterable[str], units: Iterable[str] | None) -> None:
    """`checks.<name>` must be installed; needs name checks or units of checks."""
    names = sorted(known)
    for name, check in root.get("checks").items():
        if name not in names:
            check.add_problem(unknown("check", name, names) + " (`phm checks` lists them)")
        for need in check.get("needs").texts:
            of_check, _, subject = need.text.partition("/")
            if of_check not in names:
                what = f"unknown need {shown(need.text)}"
                near = unknown("check", of_check, names)
                need.add_problem(f"{what}: {near} (write a check's name or the id of a unit, check/subject)")
            elif subject and units is not None and need.text not in units:
                theirs = sorted(unit for unit in units if unit.startswith(f"{of_check}/"))
                need.add_problem(unknown("unit", need.text, [of_check, *theirs]))


def names_of_recovery(root: ConfigNode, actions: Iterable[str] | None) -> None:
    """`recovery.ladders`: conditions to lists of actions. `phm validate` warns about unknown conditions."""
    for place in [place for _, ladder in root.get("recovery", "ladders").items() for place in ladder.texts]:
        if actions is not None and place.text not in actions:
            place.add_problem(unknown("action", place.text, sorted(actions)))


def needs_have_no_loop(root: ConfigNode, builtin: dict[str, set[str]]) -> None:
    """The needs in the file, together with the built-in ones, must not form a cycle.

    Each cycle is reported once, at the need in the file that closes it.
    """
    graph = {name: set(needs) for name, needs in builtin.items()}
    written: list[tuple[str, str, ConfigNode]] = []
    for name, check in root.get("checks").items():
        if check.get("enabled").value is False:
            continue
        for place in check.get("needs").texts:
            need = place.text.partition("/")[0]
            if need == name and "/" in place.text:
                continue  # all units of a check may need one of them
            written.append((name, need, place))
            graph.setdefault(name, set()).add(need)
    reported: set[frozenset[str]] = set()
    for name, need, place in written:
        way = shortest_path(graph, need, name)
        if way is not None and frozenset(way) not in reported:
            reported.add(frozenset(way))
            place.add_problem(f"dependency cycle: {' -> '.join([name, *way])} (remove one of these needs)")
