"""Build the checks and the units to track from the configuration and the installed checks."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from phm.api import Check
from phm.checking.check_turns import ScheduledCheck
from phm.core.dependency_graph import DependencyGraph
from phm.core.settings import CheckSettings, Settings
from phm.tracker import TrackedUnit, all_needs, graph_of
from phm.tracker.tracker import PRESSURE

HOST_PRESSURE = ("host/cpu", "host/io", "host/memory")


@dataclass(frozen=True, slots=True)
class CheckPlan:
    """The scheduled checks, the tracked units in the same order, and their dependency graph."""

    scheduled: tuple[ScheduledCheck, ...]
    tracked: tuple[TrackedUnit, ...]
    graph: DependencyGraph

    def below(self, unit: str) -> Mapping[str, frozenset[str]]:
        """Dependents of `unit` in other containers, by container."""
        targets = {entry.unit.id: entry.unit.target for entry in self.tracked}
        found: dict[str, set[str]] = {}
        for name in self.graph.downstream(unit) if unit in targets else ():
            if targets[name] not in ("", targets[unit]):
                found.setdefault(targets[name], set()).add(name)
        return {target: frozenset(units) for target, units in found.items()}

    @property
    def pass_limit_s(self) -> float:
        """Maximum duration of a report pass in seconds: the longest deadline of any check plus one second."""
        return max((entry.deadline_s for entry in self.scheduled), default=0.0) + 1.0


def unit_rows(plan: CheckPlan) -> list[dict[str, Any]]:
    """One entry per unit, in slot order. `needs` are direct dependencies; `blocks` are direct and indirect dependents."""
    known = {entry.unit.id for entry in plan.tracked}
    return [
        {
            "unit": entry.unit.id,
            "check": entry.check,
            "slot": int(entry.slot),
            "needs": [need for need in entry.needs if need in known],
            "blocks": list(plan.graph.downstream(entry.unit.id)),
            "target": entry.unit.target,
            "settle_s": entry.unit.settle_s,
            "grace_s": entry.unit.grace_s,
            "memory_s": entry.unit.memory_s,
            "failures": entry.failures,
            "suspect": entry.unit.suspect,
        }
        for entry in plan.tracked
    ]


def build_plan(settings: Settings, checks: Mapping[str, type[Check]]) -> CheckPlan:
    """Build the checks that are not disabled, and their plan. Raises `DependencyCycle` when units need each other."""
    return plan_checks(settings, {name: tuple(check.build(settings)) for name, check in checks.items()})


def plan_checks(settings: Settings, built: Mapping[str, Sequence[Check]]) -> CheckPlan:
    """The plan for checks that are built, by name. Raises `DependencyCycle`.

    Disabled ones are left out: who needs a unit of one, needs what that unit needs.
    """
    instances: list[tuple[Check, CheckSettings]] = []
    disabled: list[tuple[Check, CheckSettings]] = []
    for name, checks in sorted(built.items(), key=lambda item: (item[1][0].slot if item[1] else 0, item[0])):
        override = settings.checks.get(name, CheckSettings())
        (instances if override.enabled else disabled).extend((check, override) for check in checks)
    by_check: dict[str, list[str]] = {}
    for check, _ in (*instances, *disabled):
        by_check.setdefault(check.name, []).extend(unit.id for unit in check.units)
    scheduled = tuple(_schedule(check, override, settings.interval) for check, override in instances)
    tracked = tuple(entry for check, override in instances for entry in _track(check, override, by_check))
    known = {entry.unit.id for entry in tracked}
    skipped = {
        entry.unit.id: entry.needs
        for check, override in disabled
        for entry in _track(check, override, by_check)
        if entry.unit.id not in known
    }
    tracked = tuple(replace(entry, needs=_without(skipped, entry)) for entry in tracked)
    graph = graph_of(tracked)
    critical = (entry.key for entry in settings.containers if entry.flight_critical)
    relieved = frozenset(critical if settings.recovery.relieve else ())
    return CheckPlan(scheduled, _with_starved_by(tracked, graph, relieved), graph)


def _without(skipped: Mapping[str, Sequence[str]], entry: TrackedUnit) -> tuple[str, ...]:
    """The needs of a unit, with those of each skipped unit in its place."""
    found: dict[str, None] = {}
    waiting = list(entry.needs)
    while waiting:
        need = waiting.pop(0)
        if need not in found:
            found[need] = None
            waiting[:0] = skipped.get(need, ())
    return tuple(need for need in found if need not in skipped and need != entry.unit.id)


def _with_starved_by(
    tracked: Sequence[TrackedUnit], graph: DependencyGraph, relieved: Collection[str]
) -> tuple[TrackedUnit, ...]:
    """Add to each unit the pressure units that can explain its symptoms: of its container, of its dependencies, of the host.

    The pressure of a container may follow from that of the host. A container that recovery can relieve, in `relieved`, always has
    its own fault.
    """
    targets = {entry.unit.id: entry.unit.target for entry in tracked}
    own_faults = {f"{PRESSURE}{key}" for key in relieved}

    def starved_by(unit: str) -> tuple[str, ...]:
        if unit in HOST_PRESSURE or unit in own_faults:
            return ()
        homes = () if unit.startswith(PRESSURE) else (targets[unit], *(targets[name] for name in graph.upstream(unit)))
        names = (*(f"{PRESSURE}{home}" for home in dict.fromkeys(homes)), *HOST_PRESSURE)
        return tuple(name for name in names if name in targets)

    return tuple(replace(entry, starved_by=starved_by(entry.unit.id)) for entry in tracked)


def _schedule(check: Check, override: CheckSettings, interval_s: float) -> ScheduledCheck:
    """A check without a period runs at each pass, and after twice the report interval at the latest."""
    period_s = override.period or check.period_s or 2.0 * interval_s
    return ScheduledCheck(check, period_s, override.deadline or check.deadline_s)


def _track(check: Check, override: CheckSettings, by_check: Mapping[str, Sequence[str]]) -> list[TrackedUnit]:
    failures = override.failures or check.failures
    return [
        TrackedUnit(unit, check.name, check.slot, check.layer, failures, all_needs(unit, override.needs, by_check))
        for unit in check.units
    ]
