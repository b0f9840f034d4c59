"""Finds what is installed: checks, reporters and actions, ours and anyone's, by entry point.

Nothing is scanned or registered by import: a package that declares an entry point is found, and one
that cannot be loaded is reported with its cause and does not keep the others from running.
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
    """One entry point: its name, who provides it, and the class or the reason why there is none."""

    name: str
    source: str
    """Distribution and version, e.g. `phm-sidecar 0.1.0`."""
    loaded: type | None
    problem: str = ""


@lru_cache(maxsize=8)
def find(group: str, base: type) -> tuple[Plugin, ...]:
    """Everything declared in `group`, by name; each is loaded and must be a subclass of `base`.

    Looked for once in a process: it reads the metadata of every installed package, and PHM asks eight times while it starts.
    """
    found = [_load(point, base) for point in entry_points(group=group)]
    return tuple(sorted(_without_twins(found), key=lambda entry: entry.name))


def checks() -> dict[str, type[Check]]:
    """The usable checks by name. What could not be loaded is left out: see `find` for the reasons."""
    return usable(find(CHECKS, Check))


def usable(found: Iterable[Plugin]) -> dict[str, type]:
    return {entry.name: entry.loaded for entry in found if entry.loaded is not None}


def _load(point: EntryPoint, base: type) -> Plugin:
    """Three ways to fail, three sentences (after uvicorn's importer)."""
    source = _source(point.dist) if point.dist else "unknown distribution"

    def failed(reason: str) -> Plugin:
        return Plugin(point.name, source, None, reason)

    try:
        loaded = point.load()
    except ModuleNotFoundError as error:
        return failed(f"module {point.module!r} cannot be imported: {error}; is its package fully installed?")
    except AttributeError:
        return failed(f"module {point.module!r} has no {point.attr!r}: correct the entry point")
    except Exception as error:  # the plug-in's own code runs here; whatever it raises is about the plug-in
        return failed(f"importing {point.value!r} failed: {type(error).__name__}: {error}")
    if not (isinstance(loaded, type) and issubclass(loaded, base)):
        return failed(f"{point.value!r} is no subclass of {base.__module__}.{base.__name__}")
    if getattr(loaded, "name", None) != point.name:
        return failed(f"{point.value!r} is named {getattr(loaded, 'name', None)!r}, its entry point {point.name!r}")
    return Plugin(point.name, source, loaded)


@lru_cache(maxsize=64)
def _source(package: Distribution) -> str:
    """Name and version; each time they are asked for, the whole of its metadata is parsed."""
    return f"{package.name} {package.version}"


def _without_twins(found: list[Plugin]) -> list[Plugin]:
    """Two packages with one name: neither can be trusted to be the one that is meant, so none is used."""
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
