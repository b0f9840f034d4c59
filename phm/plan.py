"""From configuration and installed checks to what runs: scheduled checks and tracked units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from phm.api import Check
from phm.engine import Scheduled
from phm.needs import Needs
from phm.settings import CheckSettings, Settings
from phm.tracker import Tracked, all_needs


@dataclass(frozen=True, slots=True)
class Plan:
    """`scheduled` runs in threads of its own, `tracked` is what the tracker publishes, in the same order."""

    scheduled: tuple[Scheduled, ...]
    tracked: tuple[Tracked, ...]
    needs: Needs

    def below(self, unit: str) -> Mapping[str, frozenset[str]]:
        """Units that need `unit` and belong to other containers, by container."""
        targets = {entry.unit.id: entry.unit.target for entry in self.tracked}
        found: dict[str, set[str]] = {}
        for name in self.needs.downstream(unit) if unit in targets else ():
            if targets[name] not in ("", targets[unit]):
                found.setdefault(targets[name], set()).add(name)
        return {target: frozenset(units) for target, units in found.items()}

    @property
    def pass_limit_s(self) -> float:
        """A report waits this long at most: the longest deadline of any check, and a second more."""
        return max((entry.deadline_s for entry in self.scheduled), default=0.0) + 1.0


def make(settings: Settings, checks: Mapping[str, type[Check]]) -> Plan:
    """The plan for this configuration. Raises `NeedsLoop` when the needs run in a circle."""
    instances: list[tuple[Check, CheckSettings]] = []
    for name, check_class in sorted(checks.items(), key=lambda item: (item[1].slot, item[0])):
        override = settings.checks.get(name, CheckSettings())
        if override.enabled:
            instances.extend((check, override) for check in check_class.build(settings))
    by_check: dict[str, list[str]] = {}
    for check, _ in instances:
        by_check.setdefault(check.name, []).extend(unit.id for unit in check.units)
    scheduled = tuple(_schedule(check, override, settings) for check, override in instances)
    tracked = tuple(entry for check, override in instances for entry in _track(check, override, by_check))
    return Plan(scheduled, tracked, Needs({entry.unit.id: entry.needs for entry in tracked}))


def _schedule(check: Check, override: CheckSettings, settings: Settings) -> Scheduled:
    """A check without a period runs at each pass; twice the interval is its own safety net."""
    period_s = override.period or check.period_s or 2.0 * settings.interval
    return Scheduled(check, period_s, override.deadline or check.deadline_s)


def _track(check: Check, override: CheckSettings, by_check: Mapping[str, Sequence[str]]) -> list[Tracked]:
    failures = override.failures or check.failures
    return [
        Tracked(unit, check.name, check.slot, check.layer, failures, all_needs(unit, override.needs, by_check))
        for unit in check.units
    ]
