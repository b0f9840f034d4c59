"""Reads the configuration with all that is known about it: what is installed, and the units that it makes.

The config package judges names that it is given; only here, above the registry, are those names at hand.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from phm.checking.registry import ACTIONS, checks, find as find_installed, usable
from phm.config import ConfigError, Problem, find, load
from phm.recovery.base import Action

if TYPE_CHECKING:
    from phm.api import Check, Unit
    from phm.core.settings import Settings


@dataclass(frozen=True, slots=True)
class Read:
    """A good configuration: where it was, what it says, and the units that it makes, by check."""

    file: str
    settings: Settings
    units: Mapping[str, tuple[Unit, ...]]

    @property
    def unit_count(self) -> int:
        return sum(len(units) for units in self.units.values())


def read(path: str | None, environ: Mapping[str, str] | None = None) -> Read:
    """Read and judge; nothing but the file is opened. Raises `ConfigError` with every problem.

    Units exist only once the rest is right, so what concerns them (a need that names no unit, needs that
    run in a circle through those built in) is judged in a second reading.
    """
    file = str(find(path))
    installed = checks()
    names: dict[str, Any] = {
        "environ": environ,
        "known_checks": tuple(installed),
        "known_actions": tuple(usable(find_installed(ACTIONS, Action))),
    }
    settings = load(file, **names)
    units = _units(file, settings, installed)
    known_units = {unit.id for units_of_check in units.values() for unit in units_of_check}
    needs = {name: _checks_needed(name, units_of_check) for name, units_of_check in units.items()}
    settings = load(file, known_units=known_units, builtin_needs=needs, **names)
    return Read(file, settings, units)


def _units(file: str, settings: Settings, installed: Mapping[str, type[Check]]) -> dict[str, tuple[Unit, ...]]:
    """The units of each installed check, also of those that are switched off: a need may name them."""
    units: dict[str, tuple[Unit, ...]] = {}
    problems = []
    for name, check in installed.items():
        try:
            units[name] = tuple(unit for instance in check.build(settings) for unit in instance.units)
        except Exception as error:  # a plug-in's own code, which judges its own options here
            message = f"the check cannot be built: {type(error).__name__}: {error} (correct it or set enabled: false)"
            if name not in settings.checks or settings.checks[name].enabled:
                problems.append(Problem(file, 0, f"checks.{name}", message))
    if problems:
        raise ConfigError(problems)
    return units


def _checks_needed(name: str, units: Iterable[Unit]) -> set[str]:
    return {need.partition("/")[0] for unit in units for need in unit.needs} - {name}
