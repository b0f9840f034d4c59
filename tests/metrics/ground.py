"""A station in which every metric of the ground has a value, and the page that is made from it."""

from __future__ import annotations

from phm.core.model import Level, Slot
from phm.gcs.events import GcsEvent
from phm.gcs.metrics import GroundMetrics
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.testing import FakeClock
from phm.wire.openmetrics import MetricsText
from tests.gcs.bench import Ground as Fleet, autopilot, phm_heartbeat, text_frame


class Station:
    """A station over a fleet state on a fake clock."""

    def __init__(self, fleet: Fleet) -> None:
        self.commands_sent, self._fleet = 3, fleet
        self._queue: SubscriberQueue | None = None

    def subscribe(self, queue: SubscriberQueue) -> None:
        self._queue = queue

    def snapshot(self) -> tuple[int, GcsEvent]:
        radio = {"link": "gcs", "age_s": 1.0, "rssi": 100, "remrssi": 90, "noise": 30, "remnoise": 40, "txbuf": 50}
        body = {**self._fleet.snapshot(), "radios": [radio], "problems": ["a sentence"], "frames_refused": 2}
        return 0, GcsEvent(self._fleet.clock.stamp(), "snapshot", body)

    def publish(self, *found: GcsEvent) -> None:
        assert self._queue is not None
        for number, event in enumerate(found):
            self._queue.put(QueuedEvent(number, event, b""))


def ground_text() -> bytes:
    """A page on which every metric has a value."""
    fleet = Fleet(expected=(9,))
    station = Station(fleet)
    metrics = GroundMetrics(station, FakeClock())
    fleet.receive(
        phm_heartbeat(5, {Slot.CONTAINER: Level.ERROR}), autopilot(5, armed=True), text_frame(5, "A05 FAIL 2 x")
    )
    fleet.wait(60.0, phm_heartbeat(6), autopilot(6, armed=False), phm_heartbeat(7, {Slot.RATES: Level.ERROR}))
    ack = GcsEvent(fleet.clock.stamp(), "ack", {"result": "DENIED"})
    station.publish(*fleet.news, ack)
    return MetricsText(metrics.page).render("application/openmetrics-text")[0]
