"""What nodes say of themselves, kept by the daemon: the newest of each, with when it was heard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from phm.probes.ros.protocol import Heard
from phm.probes.ros.records import changer
from phm.ros_facts import BeaconFact, DiagnosticFact

_aged_beacon = changer(BeaconFact, "age_s")
_aged_status = changer(DiagnosticFact, "age_s")
_Fact = TypeVar("_Fact", BeaconFact, DiagnosticFact)

MAX_NAMES = 500
"""Of beacons, and of diagnostics: names come from outside, and must not fill the memory."""


@dataclass(frozen=True, slots=True)
class Hearsay:
    """Immutable, so that it can be read without a lock. Values are (monotonic seconds when it was told, fact)."""

    beacons: Mapping[str, tuple[float, BeaconFact]] = field(default_factory=dict)
    diagnostics: Mapping[str, tuple[float, DiagnosticFact]] = field(default_factory=dict)
    refused: int = 0
    """Messages on the beacons' topic that were none."""

    def with_news(self, news: Heard, now_s: float) -> Hearsay:
        beacons = {**self.beacons, **{name: (now_s, fact) for name, fact in news.beacons.items()}}
        for name, age_s in news.ages.items():
            if name in beacons:
                beacons[name] = (now_s, _aged_beacon(beacons[name][1], age_s))
        diagnostics = {**self.diagnostics, **{name: (now_s, fact) for name, fact in news.diagnostics.items()}}
        return Hearsay(_newest(beacons), _newest(diagnostics), max(self.refused, news.refused))

    def differs(self, news: Heard) -> bool:
        """Whether there is news worth a look at once.

        A status with another level than before, or a new one that is not OK; a beacon that is new, wavers, or comes back.
        """
        if any(
            fact.level != (self.diagnostics[name][1].level if name in self.diagnostics else 0)
            for name, fact in news.diagnostics.items()
        ):
            return True
        return any(
            name not in self.beacons or _state(fact) != _state(self.beacons[name][1])
            for name, fact in news.beacons.items()
        )

    def since(self, now_s: float) -> tuple[dict[str, BeaconFact], dict[str, DiagnosticFact]]:
        """All of it, with ages as of `now_s`."""
        return (
            {name: _aged_beacon(fact, fact.age_s + now_s - at) for name, (at, fact) in self.beacons.items()},
            {name: _aged_status(fact, fact.age_s + now_s - at) for name, (at, fact) in self.diagnostics.items()},
        )


def _state(fact: BeaconFact) -> tuple[object, ...]:
    """What must not change unnoticed: the life, who else has its name, whether two or three beats are missing, how late the
    executor is, roughly."""
    return fact.birth, fact.rivals, fact.missed > 2.0, fact.missed > 3.0, int(fact.late_s).bit_length()


def _newest(told: dict[str, tuple[float, _Fact]]) -> dict[str, tuple[float, _Fact]]:
    """At most MAX_NAMES, those heard last."""
    if len(told) <= MAX_NAMES:
        return told
    return dict(sorted(told.items(), key=lambda item: item[1][0])[-MAX_NAMES:])
