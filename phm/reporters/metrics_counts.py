"""What has happened since PHM started, counted from events, for the metrics of an agent."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

from phm.core.model import NOT_OBSERVED, ActionEvent, Event, Fault, FaultClosed, FaultOpened, Outcome, Report, Slot
from phm.reporters import metrics_catalog as metrics
from phm.wire.metrics_page import HistogramCounts, Labels, MetricsPage

KINDS = (FaultOpened, FaultClosed, ActionEvent, Report)


def slot_name(slot: Slot) -> str:
    """Value of the label `slot`."""
    return slot.name.lower()


class EventCounts:
    """Thread-safe. slot_of: the slot of a unit; None: there is no such unit."""

    def __init__(self, slot_of: Callable[[str], Slot | None]) -> None:
        self._slot_of = slot_of
        self._alarms: Counter[Labels] = Counter()
        self._closed: Counter[Labels] = Counter()
        self._actions: Counter[Labels] = Counter()
        self._recovery: dict[Labels, HistogramCounts] = {}
        self._confirmation: dict[Labels, HistogramCounts] = {}
        self._report_at: float | None = None
        self._lock = threading.Lock()

    def take(self, event: Event) -> None:
        with self._lock:
            if isinstance(event, FaultOpened):
                self._opened(event.fault)
            elif isinstance(event, FaultClosed):
                self._ended(event.fault)
            elif isinstance(event, ActionEvent):
                slot = self._slot_of(event.unit)
                if slot is not None:
                    self._actions[slot_name(slot), event.action, event.phase.value] += 1
            elif isinstance(event, Report):
                self._report_at = event.at.mono

    def add_to(self, page: MetricsPage, now: float) -> None:
        with self._lock:
            page.add_counts(metrics.ALARMS, self._alarms)
            page.add_counts(metrics.FAULTS, self._closed)
            page.add_counts(metrics.ACTIONS, self._actions)
            page.add_histograms(metrics.RECOVERY, self._recovery)
            page.add_histograms(metrics.CONFIRMATION, self._confirmation)
            if self._report_at is not None:
                page.add(metrics.REPORT_AGE, now - self._report_at)

    def _opened(self, fault: Fault) -> None:
        self._alarms[(slot_name(fault.slot),)] += 1
        if fault.confirmed_s is not None:
            _observe(self._confirmation, fault, fault.confirmed_s)

    def _ended(self, fault: Fault) -> None:
        self._closed[slot_name(fault.slot), fault.outcome.value] += 1
        if fault.outcome is Outcome.RESOLVED and fault.closed is not None and fault.by not in NOT_OBSERVED:
            _observe(self._recovery, fault, fault.closed.mono - fault.opened.mono)


def _observe(histograms: dict[Labels, HistogramCounts], fault: Fault, value: float) -> None:
    labels = (slot_name(fault.slot),)
    if labels not in histograms:
        histograms[labels] = HistogramCounts(metrics.SECONDS)
    histograms[labels].observe(value)
