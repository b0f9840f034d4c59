"""Rules for `custom`."""

from __future__ import annotations

import re
from collections.abc import Iterable

from phm.config.node import ConfigNode
from phm.config.problems import shown, unknown
from phm.config.rules.common import configured, container_key, in_order, report_duplicates, shortest_path
from phm.core.settings import CustomBase, RecoverySettings, Seconds

PATTERNS = ("body",)
"""Keys with a regular expression; those of `patterns` are found there."""


def custom_names_are_unique(root: ConfigNode) -> None:
    entries = root.get("custom").records()
    report_duplicates("check", ((entry.get("name").text, entry.get("name")) for entry in entries))


def custom_containers_exist(root: ConfigNode) -> None:
    """Containers are configured, and recovery acts only on one that has opted in, for a check that opens faults."""
    known = {container_key(container): container for container in root.get("containers").records()}
    known.pop("", None)
    for entry in root.get("custom").records():
        if entry.get("container").text:
            configured(entry.get("container"), known)
        place = entry.get("recovery", "container")
        if place.text and configured(place, known) and known[place.text].get("recover").value is not True:
            place.add_problem(
                f"is {shown(place.text)}, which has no 'recover: true' (line {known[place.text].line}): add it there, "
                "or remove 'recovery'"
            )
        if entry.get("recovery").given and entry.get("level").value == "warn":
            entry.get("recovery").add_problem(
                "is never used with 'level: warn', which opens no fault: remove one of the two"
            )
        if entry.get("recovery").given:
            defaults = (CustomBase.model_fields["grace"].default, RecoverySettings().verify)
            in_order(entry.get("grace"), root.get("recovery", "verify"), Seconds, defaults)


def custom_patterns_compile(root: ConfigNode) -> None:
    for entry in root.get("custom").records():
        in_list = [one.get("pattern") for one in entry.get("patterns").records()]
        for place in (*(entry.get(key) for key in PATTERNS), *in_list):
            try:
                re.compile(place.text)
            except (re.error, OverflowError, RecursionError) as error:
                place.add_problem(f"is {shown(place.text)}, which is not a regular expression: {error}")


def custom_keys_fit(root: ConfigNode) -> None:
    """Keys that need or exclude each other."""
    for entry in root.get("custom").records():
        kind = entry.get("type").text
        if kind == "log" and entry.get("path").given and entry.get("container").given:
            entry.add_problem("has 'path' and 'container': keep the one whose log is read")
        elif kind == "log" and not entry.get("path").given and not entry.get("container").given:
            entry.add_problem("has no log: give 'path' or 'container'")
        elif kind == "http" and entry.get("equals").given and not entry.get("json_field").given:
            entry.get("equals").add_problem("is never used without 'json_field': add it or remove this")
        elif kind == "process" and entry.get("max_count").given:
            in_order(entry.get("min_count"), entry.get("max_count"), int, (1, 1))


def custom_needs_have_no_loop(root: ConfigNode) -> None:
    """Own checks must not need each other. Each cycle is reported once, at the first need of it."""
    written = [
        (f"custom/{entry.get('name').text}", place)
        for entry in root.get("custom").records()
        for place in entry.get("needs").texts
    ]
    graph: dict[str, set[str]] = {}
    for own, place in written:
        graph.setdefault(own, set()).add(place.text)
    reported: set[frozenset[str]] = set()
    for own, place in written:
        way = shortest_path(graph, place.text, own)
        if way is not None and place.text != own and frozenset(way) not in reported:
            reported.add(frozenset(way))
            place.add_problem(f"dependency cycle: {' -> '.join([own, *way])} (remove one of these needs)")


def custom_needs_are_units(root: ConfigNode, units: Iterable[str]) -> None:
    """Each need is the id of a unit, and not the check itself."""
    known = sorted(units)
    for entry in root.get("custom").records():
        own = f"custom/{entry.get('name').text}"
        for need in entry.get("needs").texts:
            if need.text == own:
                need.add_problem(f"is {shown(own)}, the check itself: remove it")
            elif need.text not in known:
                same = [unit for unit in known if unit.startswith(f"{need.text.partition('/')[0]}/")]
                hint = " (without this need, `phm checks --graph` lists them)"
                need.add_problem(unknown("unit", need.text, same or known) + hint)
