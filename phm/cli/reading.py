"""Reads and validates the configuration with the names of the installed checks and actions, and of the units it defines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from phm.checking.registry import ACTIONS, checks, find as find_installed, usable
from phm.config import ConfigError, Problem, find, load
from phm.recovery.base import Action

if TYPE_CHECKING:
    from phm.api import Check, Unit
    from phm.core.settings import Settings


@dataclass(frozen=True, slots=True)
class Read:
    """A valid configuration: its file, its settings, and its units by check."""

    file: str
    settings: Settings
    units: Mapping[str, tuple[Unit, ...]]

    @property
    def unit_count(self) -> int:
        return sum(len(units) for units in self.units.values())


def read(path: str | None, environ: Mapping[str, str] | None = None) -> Read:
    """Opens nothing but the file. Raises `ConfigError` with every problem.

    Units exist only when the rest is valid, so the rules about them (needs that name units, cycles with built-in needs) are
    applied afterwards.
    """
    file = str(find(path))
    installed = checks()
    units: dict[str, tuple[Unit, ...]] = {}

    def units_of(settings: Settings) -> tuple[set[str], dict[str, set[str]]]:
        units.update(_units(file, settings, installed))
        known = {unit.id for units_of_check in units.values() for unit in units_of_check}
        return known, {name: _checks_needed(name, units_of_check) for name, units_of_check in units.items()}

    actions = tuple(usable(find_installed(ACTIONS, Action)))
    settings = load(file, environ=environ, known_checks=tuple(installed), known_actions=actions, units_of=units_of)
    return Read(file, settings, units)


def _units(file: str, settings: Settings, installed: Mapping[str, type[Check]]) -> dict[str, tuple[Unit, ...]]:
    """The units of each installed check, also of disabled ones, which a need may name."""
    units: dict[str, tuple[Unit, ...]] = {}
    problems = []
    for name, check in installed.items():
        try:
            units[name] = tuple(unit for instance in check.build(settings) for unit in instance.units)
        except Exception as error:  # a plug-in's code, which validates its own options here
            message = f"the check cannot be built: {type(error).__name__}: {error} (fix it or set enabled: false)"
            if name not in settings.checks or settings.checks[name].enabled:
                problems.append(Problem(file, 0, f"checks.{name}", message))
    if problems:
        raise ConfigError(problems)
    return units


def _checks_needed(name: str, units: Iterable[Unit]) -> set[str]:
    return {need.partition("/")[0] for unit in units for need in unit.needs} - {name}
