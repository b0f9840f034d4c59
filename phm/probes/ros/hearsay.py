"""What nodes say of themselves, kept by the daemon: the newest of each, with when it was heard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from phm.probes.ros.protocol import Heard
from phm.ros_facts import BeaconFact, DiagnosticFact

_Fact = TypeVar("_Fact", BeaconFact, DiagnosticFact)

MAX_NAMES = 500
"""Of beacons, and of diagnostics: names come from outside, and must not fill the memory."""


@dataclass(frozen=True, slots=True)
class Hearsay:
    """Immutable, so that it can be read without a lock. Values are (monotonic seconds when it was told, fact)."""

    beacons: Mapping[str, tuple[float, BeaconFact]] = field(default_factory=dict)
    diagnostics: Mapping[str, tuple[float, DiagnosticFact]] = field(default_factory=dict)

    def with_news(self, news: Heard, now_s: float) -> Hearsay:
        beacons = {**self.beacons, **{name: (now_s, fact) for name, fact in news.beacons.items()}}
        diagnostics = {**self.diagnostics, **{name: (now_s, fact) for name, fact in news.diagnostics.items()}}
        return Hearsay(_newest(beacons), _newest(diagnostics))

    def differs(self, news: Heard) -> bool:
        """Whether a status in `news` has another level than before, or is new and not OK: worth a look at once."""
        return any(
            fact.level != (self.diagnostics[name][1].level if name in self.diagnostics else 0)
            for name, fact in news.diagnostics.items()
        )

    def since(self, now_s: float) -> tuple[dict[str, BeaconFact], dict[str, DiagnosticFact]]:
        """All of it, with ages as of `now_s`."""
        return (
            {name: replace(fact, age_s=fact.age_s + now_s - at) for name, (at, fact) in self.beacons.items()},
            {name: replace(fact, age_s=fact.age_s + now_s - at) for name, (at, fact) in self.diagnostics.items()},
        )


def _newest(told: dict[str, tuple[float, _Fact]]) -> dict[str, tuple[float, _Fact]]:
    """At most MAX_NAMES, those heard last."""
    if len(told) <= MAX_NAMES:
        return told
    return dict(sorted(told.items(), key=lambda item: item[1][0])[-MAX_NAMES:])
