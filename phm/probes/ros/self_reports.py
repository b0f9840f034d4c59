"""The newest beacon and diagnostic status of each node with its time of arrival, kept by the daemon."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from phm.facts.ros import BeaconFact, DiagnosticFact
from phm.probes.ros.fact_codec import changer
from phm.probes.ros.protocol import SelfReportUpdate

_aged_beacon = changer(BeaconFact, "age_s")
_aged_status = changer(DiagnosticFact, "age_s")
_late_beacon = changer(BeaconFact, "not_counted_s")
_late_status = changer(DiagnosticFact, "not_counted_s")
_Fact = TypeVar("_Fact", BeaconFact, DiagnosticFact)

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
        diagnostics = {**self.diagnostics, **{name: (now_s, fact) for name, fact in update.diagnostics.items()}}
        diagnostics = _newest(diagnostics, self.configured.is_status)
        kept = _newest_of_each(self.configured.statuses, diagnostics)
        return SelfReports(
            _newest(beacons, self.configured.is_node),
            kept,
            max(self.refused, update.refused),
            now_s if update.lost else self.lost_at,
            now_s if len(kept) < len(diagnostics) else self.unkept_at,
            self.configured,
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
        self, now_s: float, late: Callable[[float], float] = lambda passed_s: 0.0
    ) -> tuple[dict[str, BeaconFact], dict[str, DiagnosticFact]]:
        """Beacons and statuses that are valid evidence, with ages as of `now_s`. late: for a number of seconds until then,
        the part in which the child did not run."""
        beacons = {name: _aged_beacon(fact, fact.age_s + now_s - at) for name, (at, fact) in self.beacons.items()}
        statuses = {name: _aged_status(fact, fact.age_s + now_s - at) for name, (at, fact) in self.diagnostics.items()}
        beacons |= {name: _late_beacon(fact, late_s) for name, fact in beacons.items() if (late_s := late(fact.age_s))}
        statuses |= {
            name: _late_status(fact, late_s) for name, fact in statuses.items() if (late_s := late(fact.age_s))
        }
        return {name: fact for name, fact in beacons.items() if not self._unproved(fact, now_s)}, statuses

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
    newest = sorted(found, key=lambda name: found[name][0], reverse=True)
    matching = [[name for name in newest if _pattern(words).fullmatch(name)] for words in patterns]
    kept = {name for names in matching for name in names[:MAX_NAMES]}
    dropped = {name for names in matching for name in names} - kept
    return {name: entry for name, entry in found.items() if name not in dropped}
