"""The ground stations that are received, and when each was received last. Pure; the caller brings time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass

from phm.probes.adaptive_timeout import UNEVEN_S, AdaptiveTimeout
from phm.wire.gcs_marker import MONITOR

MAX_STATIONS = 16


@dataclass(frozen=True, slots=True)
class StationBeat:
    """The last HEARTBEAT of a ground station: monotonic seconds, its MAVLink ids, and the endpoint that received it."""

    at: float
    system: int
    component: int
    link: str


class GroundStations:
    """Not thread-safe. timeout_s: a station that is silent for longer is lost."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._heard: OrderedDict[tuple[int, int], StationBeat] = OrderedDict()
        # A ground station may freeze while its operator loads a map, and all agents would report it: half of the timeout.
        self.cadence = AdaptiveTimeout(timeout_s, max(UNEVEN_S, timeout_s / 2))
        self.left = False
        """The last one has announced its end."""
        self.last: StationBeat | None = None

    def beat(self, beat: StationBeat, late_s: float = 0.0) -> None:
        """late_s: for how long since the last one PHM did not run."""
        key = (beat.system, beat.component)
        self._heard.pop(key, None)
        self._heard[key] = self.last = beat
        if len(self._heard) > MAX_STATIONS:
            self._heard.popitem(last=False)
        self.cadence.beat(beat.at, late_s)
        self.left = False

    def leave(self, system: int, component: int, now: float) -> None:
        """A station announced its end: another one that is received counts, or none is expected any more."""
        if self._heard.pop((system, component), None) is None or self.last is None:
            return
        if (self.last.system, self.last.component) != (system, component):
            return
        self.cadence.broke(now)
        other = next(reversed(self._heard.values()), None)
        if other is not None and now - other.at <= self._timeout_s:
            self.last = other
        else:
            self.left = True


def counts_as_pilot(system: int, custom_mode: int, pilots: Collection[int]) -> bool:
    """Whether a ground station is the pilot's. pilots: `mavlink.pilots`; empty: every one but `phm gcs`."""
    return system in pilots if pilots else custom_mode != MONITOR
