"""Find installed checks, reporters and actions by entry point, including those of other packages.

A plug-in that cannot be loaded is reported with the cause and does not prevent the others from running.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, entry_points

from phm.api import Check

CHECKS, REPORTERS, ACTIONS = "phm.checks", "phm.reporters", "phm.actions"


@dataclass(frozen=True, slots=True)
class Plugin:
    """One entry point: its name, its distribution, and the loaded class or the reason why it could not be loaded."""

    name: str
    source: str
    """Distribution and version, e.g. `phm-sidecar 0.1.0`."""
    loaded: type | None
    problem: str = ""


@lru_cache(maxsize=8)
def find(group: str, base: type) -> tuple[Plugin, ...]:
    """All entry points of `group`, sorted by name; each must load as a subclass of `base`.

    Cached, because it reads the metadata of every installed package.
    """
    found = [_load(point, base) for point in entry_points(group=group)]
    return tuple(sorted(_without_duplicates(found), key=lambda entry: entry.name))


def checks() -> dict[str, type[Check]]:
    """The usable checks by name. Checks that could not be loaded are left out: see `find` for the reasons."""
    return usable(find(CHECKS, Check))


def usable(found: Iterable[Plugin]) -> dict[str, type]:
    return {entry.name: entry.loaded for entry in found if entry.loaded is not None}


def _load(point: EntryPoint, base: type) -> Plugin:
    """Load one entry point; each kind of failure has its own message."""
    source = _source(point.dist) if point.dist else "unknown distribution"

    def failed(reason: str) -> Plugin:
        return Plugin(point.name, source, None, reason)

    try:
        loaded = point.load()
    except ModuleNotFoundError as error:
        return failed(f"module {point.module!r} cannot be imported: {error}: install its package again")
    except AttributeError:
        return failed(f"module {point.module!r} has no {point.attr!r}: correct the entry point")
    except (Exception, SystemExit) as error:  # the plug-in's own code: whatever it raises is a problem of the plug-in
        return failed(f"importing {point.value!r} failed: {type(error).__name__}: {error}")
    if not (isinstance(loaded, type) and issubclass(loaded, base)):
        return failed(f"{point.value!r} is not a subclass of {base.__module__}.{base.__name__}")
    if getattr(loaded, "name", None) != point.name:
        return failed(
            f"{point.value!r} has the name {getattr(loaded, 'name', None)!r}, but its entry point is {point.name!r}: give both the same name"
        )
    return Plugin(point.name, source, loaded)


@lru_cache(maxsize=64)
def _source(package: Distribution) -> str:
    """Name and version, cached because each access parses all metadata."""
    return f"{package.name} {package.version}"


def _without_duplicates(found: list[Plugin]) -> list[Plugin]:
    """Of several packages that provide the same name, use none: which one is intended is unclear."""
    names: dict[str, list[Plugin]] = {}
    for entry in found:
        names.setdefault(entry.name, []).append(entry)
    result: list[Plugin] = []
    for name, entries in names.items():
        sources = sorted({entry.source for entry in entries})
        if len(sources) == 1:
            result.append(entries[0])
        else:
            result.append(
                Plugin(name, ", ".join(sources), None, f"several packages provide {name!r}: remove all but one")
            )
    return result
