"""Read the configuration file once: settings, the checks built for them, and their dependency graph."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from phm.api import Check, Unit
from phm.checking.plan import CheckPlan, plan_checks
from phm.checking.registry import ACTIONS, checks, find as find_installed, usable
from phm.config import ConfigError, Problem, find, load, loads
from phm.core.dependency_graph import DependencyCycle
from phm.core.settings import Settings
from phm.recovery.base import Action

FIXED = ("agent", "mavlink", "process", "state_dir", "run_dir", "delivery")
"""Sections that need a restart: the agent's identity, its links, its priority, the directories that are locked, and the port for
configurations."""


def fixed_sections(settings: Settings) -> dict[str, object]:
    """The sections that need a restart, by name."""
    return {name: getattr(settings, name) for name in FIXED}


@dataclass(frozen=True, slots=True)
class Configuration:
    """A valid configuration: its file, its settings, its units by check (also of disabled checks), and what runs."""

    file: str
    settings: Settings
    units: Mapping[str, tuple[Unit, ...]]
    plan: CheckPlan

    @property
    def unit_count(self) -> int:
        return sum(len(units) for units in self.units.values())


def read(path: str | None, environ: Mapping[str, str] | None = None, *, links: bool = True) -> Configuration:
    """Open nothing but the file. Raises `ConfigError` with every problem.

    Units exist only when the rest is valid, so the rules about them (needs that name units, cycles with built-in needs) are
    applied afterwards.

    links: False: settings and checks as if there were no MAVLink endpoints.
    """
    file = str(find(path))
    return _read(file, partial(load, file, environ=environ), links=links)


def read_text(text: str, file: str, environ: Mapping[str, str]) -> Configuration:
    """As `read`, from the text of a file that need not exist. Raises `ConfigError` with every problem."""
    return _read(file, partial(loads, text, file, environ=environ), links=True)


def plan_of(text: str, file: str, environ: Mapping[str, str]) -> CheckPlan:
    """The plan of `read_text`."""
    return read_text(text, file, environ).plan


def _read(file: str, load: Callable[..., Settings], *, links: bool) -> Configuration:
    installed = checks()
    built: dict[str, tuple[Check, ...]] = {}

    def units_of(settings: Settings) -> tuple[set[str], dict[str, set[str]]]:
        used = settings if links else _without_links(settings)
        built.update(_build(file, used, installed))
        judged = built
        if used is not settings and any(entry.needs for entry in (*settings.checks.values(), *settings.custom)):
            judged = _build(file, settings, installed)  # a need may name a unit of a link
        units = {name: _units(instances) for name, instances in judged.items()}
        known = {unit.id for units_of_check in units.values() for unit in units_of_check}
        return known, {name: _checks_needed(name, units_of_check) for name, units_of_check in units.items()}

    actions = tuple(usable(find_installed(ACTIONS, Action)))
    settings = load(known_checks=tuple(installed), known_actions=actions, units_of=units_of)
    if not links:
        settings = _without_links(settings)
    try:
        plan = plan_checks(settings, built)
    except DependencyCycle as error:
        raise ConfigError([Problem(file, 0, "checks", str(error))]) from None
    return Configuration(file, settings, {name: _units(instances) for name, instances in built.items()}, plan)


def _without_links(settings: Settings) -> Settings:
    if not settings.mavlink.endpoints:
        return settings
    return settings.model_copy(update={"mavlink": settings.mavlink.model_copy(update={"endpoints": []})})


def _build(file: str, settings: Settings, installed: Mapping[str, type[Check]]) -> dict[str, tuple[Check, ...]]:
    """The instances of each installed check, also of disabled ones, whose units a need may name."""
    built: dict[str, tuple[Check, ...]] = {}
    problems = []
    for name, check in installed.items():
        try:
            instances = tuple(check.build(settings))
            _units(instances)
        except Exception as error:  # a plug-in's code, which validates its own options here
            message = f"the check cannot be built: {type(error).__name__}: {error} (fix it or set enabled: false)"
            if name not in settings.checks or settings.checks[name].enabled:
                problems.append(Problem(file, 0, f"checks.{name}", message))
        else:
            built[name] = instances
    if problems:
        raise ConfigError(problems)
    return built


def _units(instances: Sequence[Check]) -> tuple[Unit, ...]:
    return tuple(unit for check in instances for unit in check.units)


def _checks_needed(name: str, units: Iterable[Unit]) -> set[str]:
    return {need.partition("/")[0] for unit in units for need in unit.needs} - {name}
