"""The newest beacon and diagnostic status of each node with its time of arrival, kept by the daemon."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from phm.facts.ros import BeaconFact, DiagnosticFact
from phm.probes.ros.diagnostic_sources import DiagnosticSource, counting, name_of, newest
from phm.probes.ros.fact_codec import changer
from phm.probes.ros.protocol import SelfReportUpdate

_aged_beacon = changer(BeaconFact, "age_s")
_aged_status = changer(DiagnosticFact, "age_s")
_late_beacon = changer(BeaconFact, "not_counted_s")
_late_status = changer(DiagnosticFact, "not_counted_s")
_Fact = TypeVar("_Fact", BeaconFact, DiagnosticFact)
Late = Callable[[float], float]
"""For a number of seconds until now, the part in which the child did not run."""

MAX_NAMES = 500
"""Limit for unconfigured beacons, unconfigured statuses, and the statuses that match one pattern: names from outside must not fill
the memory."""
SILENT_MISSES = 3.0


@dataclass(frozen=True, slots=True)
class ConfiguredNames:
    """The configured full node names, and patterns of statuses with `*` and `?`."""

    nodes: frozenset[str] = frozenset()
    statuses: tuple[str, ...] = ()

    def is_node(self, name: str) -> bool:
        return name in self.nodes

    def is_status(self, name: str) -> bool:
        return any(_pattern(words).fullmatch(name) for words in self.statuses)


@functools.cache
def _pattern(words: str) -> re.Pattern[str]:
    """Only `*` and `?` are special, as in the check `diagnostics`."""
    parts = {"*": ".*", "?": "."}
    return re.compile("".join(parts.get(char, re.escape(char)) for char in words), re.DOTALL)


@dataclass(frozen=True, slots=True)
class SelfReports:
    """Immutable, so that it can be read without a lock. Values are (monotonic seconds of the report, fact)."""

    beacons: Mapping[str, tuple[float, BeaconFact]] = field(default_factory=dict)
    diagnostics: Mapping[str, tuple[float, DiagnosticFact]] = field(default_factory=dict)
    """By source: `phm.probes.ros.diagnostic_sources.key_of`."""
    first_s: Mapping[str, float] = field(default_factory=dict)
    """When each source of a status was received for the first time."""
    named: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The sources of each name that count, the one received last first."""
    refused: int = 0
    """Number of messages on the beacon topic that were not valid beacons."""
    lost_at: float | None = None
    """When more beacons arrived than can be read."""
    unkept_at: float | None = None
    """When more statuses matched one pattern than are kept."""
    configured: ConfiguredNames = field(default_factory=ConfiguredNames)

    def with_update(self, update: SelfReportUpdate, now_s: float) -> SelfReports:
        beacons = {**self.beacons, **{name: (now_s, fact) for name, fact in update.beacons.items()}}
        for name, age_s in update.ages.items():
            if name in beacons:
                beacons[name] = (now_s, _aged_beacon(beacons[name][1], age_s))
        known = replace(
            self,
            beacons=_newest(beacons, self.configured.is_node),
            refused=max(self.refused, update.refused),
            lost_at=now_s if update.lost else self.lost_at,
        )
        return known._with_statuses(update.diagnostics, now_s) if update.diagnostics else known

    def _with_statuses(self, statuses: Mapping[str, DiagnosticFact], now_s: float) -> SelfReports:
        received = _few_of_each({**self.diagnostics, **{key: (now_s, fact) for key, fact in statuses.items()}})
        received = _newest(received, lambda key: self.configured.is_status(name_of(key)))
        kept = _newest_of_each(self.configured.statuses, received)
        first_s = {key: self.first_s.get(key, at) for key, (at, _) in kept.items()}
        return replace(
            self,
            diagnostics=kept,
            first_s=first_s,
            named={name: counting(_received(sources, first_s)) for name, sources in _by_name(kept).items()},
            unkept_at=now_s if len(kept) < len(received) else self.unkept_at,
        )

    def differs(self, update: SelfReportUpdate) -> bool:
        """Whether checks must run immediately.

        True for a status with a changed level, a new status that is not OK, and a beacon that is new, late or back.
        """
        if any(
            fact.level != (self.diagnostics[name][1].level if name in self.diagnostics else 0)
            for name, fact in update.diagnostics.items()
        ):
            return True
        return any(
            name not in self.beacons or _state(fact) != _state(self.beacons[name][1])
            for name, fact in update.beacons.items()
        )

    def since(
        self, now_s: float, late: Late = lambda passed_s: 0.0
    ) -> tuple[dict[str, BeaconFact], dict[str, DiagnosticFact]]:
        """Beacons that are valid evidence and the newest status of each name, with ages as of `now_s`."""
        beacons = {name: _aged_beacon(fact, fact.age_s + now_s - at) for name, (at, fact) in self.beacons.items()}
        statuses = {name: self._status(keys[0], now_s, late) for name, keys in self.named.items()}
        beacons |= {name: _late_beacon(fact, late_s) for name, fact in beacons.items() if (late_s := late(fact.age_s))}
        return {name: fact for name, fact in beacons.items() if not self._unproved(fact, now_s)}, statuses

    def same_named(self, now_s: float, late: Late = lambda passed_s: 0.0) -> dict[str, tuple[DiagnosticFact, ...]]:
        """The statuses of each name that several publishers use."""
        several = {name: keys for name, keys in self.named.items() if len(keys) > 1}
        return {name: tuple(self._status(key, now_s, late) for key in keys) for name, keys in several.items()}

    def _status(self, key: str, now_s: float, late: Late) -> DiagnosticFact:
        at, fact = self.diagnostics[key]
        aged: DiagnosticFact = _aged_status(fact, fact.age_s + now_s - at)
        late_s = late(aged.age_s)
        return _late_status(aged, late_s) if late_s else aged

    def _unproved(self, fact: BeaconFact, now_s: float) -> bool:
        """Whether the beacon is silent but its messages may have been lost because too many arrived."""
        return fact.missed > SILENT_MISSES and self.lost_at is not None and now_s - self.lost_at < fact.age_s


def _state(fact: BeaconFact) -> tuple[object, ...]:
    """Fields whose changes must be noticed: the run of the node, other processes with its name or identity, whether two or three
    heartbeats are missing, and roughly how late its executor is."""
    return fact.birth, fact.rivals, fact.copied_by, fact.missed > 2.0, fact.missed > 3.0, int(fact.late_s).bit_length()


def _newest(found: dict[str, tuple[float, _Fact]], is_own: Callable[[str], bool]) -> dict[str, tuple[float, _Fact]]:
    """All configured entries, and at most MAX_NAMES others, those received last."""
    if len(found) <= MAX_NAMES:
        return found
    others = sorted((name for name in found if not is_own(name)), key=lambda name: found[name][0])
    dropped = set(others[: max(0, len(others) - MAX_NAMES)])
    return {name: entry for name, entry in found.items() if name not in dropped}


def _newest_of_each(patterns: tuple[str, ...], found: dict[str, tuple[float, _Fact]]) -> dict[str, tuple[float, _Fact]]:
    """Of the entries that match a pattern, those received last: MAX_NAMES for each, so that no pattern displaces those of another."""
    if len(found) <= MAX_NAMES:
        return found
    latest = sorted(found, key=lambda key: found[key][0], reverse=True)
    matching = [[key for key in latest if _pattern(words).fullmatch(name_of(key))] for words in patterns]
    kept = {name for names in matching for name in names[:MAX_NAMES]}
    dropped = {name for names in matching for name in names} - kept
    return {name: entry for name, entry in found.items() if name not in dropped}


_Statuses = dict[str, tuple[float, DiagnosticFact]]


def _by_name(found: _Statuses) -> dict[str, _Statuses]:
    named: dict[str, _Statuses] = {}
    for key, entry in found.items():
        named.setdefault(name_of(key), {})[key] = entry
    return named


def _received(sources: _Statuses, first_s: Mapping[str, float]) -> dict[str, DiagnosticSource]:
    return {key: DiagnosticSource(first_s.get(key, at), at, fact.hardware_id) for key, (at, fact) in sources.items()}


def _few_of_each(found: _Statuses) -> _Statuses:
    """The sources of each name that are kept."""
    named = _by_name(found)
    if len(named) == len(found):
        return found
    return {key: found[key] for sources in named.values() for key in newest(_received(sources, {}))}
