"""The ground stations that are received, and when each was received last. Pure; the caller brings time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass, replace

from phm.probes.adaptive_timeout import UNEVEN_S, AdaptiveTimeout
from phm.wire.gcs_marker import MONITOR

MAX_STATIONS = 16


@dataclass(frozen=True, slots=True)
class StationHeartbeat:
    """The last HEARTBEAT of a ground station: monotonic seconds, its MAVLink ids, the endpoint that received it, and
    whether it is signed."""

    at: float
    system: int
    component: int
    link: str
    signed: bool = False


class GroundStations:
    """Not thread-safe. timeout_s: a station that is silent for longer is lost."""

    def __init__(self, timeout_s: float) -> None:
        self._received: OrderedDict[tuple[int, int], StationHeartbeat] = OrderedDict()
        # A ground station may freeze while its operator loads a map, and all agents would report it: half of the timeout.
        self.cadence = AdaptiveTimeout(timeout_s, max(UNEVEN_S, timeout_s / 2))
        self.left = False
        """Whether all ground stations have announced their end."""
        self.last: StationHeartbeat | None = None

    def heartbeat(self, beat: StationHeartbeat, late_s: float = 0.0) -> None:
        """late_s: for how long since the last one PHM did not run."""
        key = (beat.system, beat.component)
        before = self._received.pop(key, None)
        if before is not None and before.signed:
            beat = replace(beat, signed=True)  # an unsigned one may be forged
        self._received[key] = self.last = beat
        if len(self._received) > MAX_STATIONS:
            self._received.popitem(last=False)
        self.cadence.heartbeat(beat.at, late_s)
        self.left = False

    def announce_end(self, system: int, component: int, now: float, *, signed: bool = False) -> None:
        """A station announced its end: the newest of the others counts, also a silent one. Without others none is expected any more.

        signed: the farewell is. A station that has signed leaves only with a signature.
        """
        received = self._received.get((system, component))
        if received is None or self.last is None or (received.signed and not signed):
            return
        del self._received[system, component]
        if (self.last.system, self.last.component) != (system, component):
            return
        self.cadence.broke(now)
        self.last = next(reversed(self._received.values()), self.last)
        self.left = not self._received


def counts_as_pilot(system: int, custom_mode: int, pilots: Collection[int]) -> bool:
    """Whether a ground station is the pilot's. pilots: `mavlink.pilots`; empty: every one but `phm gcs`."""
    return system in pilots if pilots else custom_mode != MONITOR
