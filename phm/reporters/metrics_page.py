"""The page of metrics of an agent, from what its daemon knows at this moment: nothing is measured or asked for it.

Measurements are those of the newest results, so they are as old as the period of their check.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from typing import Any

import psutil

from phm import __version__
from phm.core.model import Fault, Layer, UnitState, Value, worst_by_slot
from phm.reporters import metrics_catalog as metrics
from phm.reporters.base import ReporterContext
from phm.reporters.metrics_counts import EventCounts, slot_name
from phm.wire import status_word
from phm.wire.metrics_page import Metric, MetricsPage, number, ratio

Values = Mapping[str, Value]
_PERCENT: Mapping[str, Metric] = {
    "cpu_percent": metrics.CPU_RATIO,
    "memory_percent": metrics.MEMORY_RATIO,
    "memory_stalled_percent": metrics.MEMORY_STALLED,
    "io_stalled_percent": metrics.IO_STALLED,
}
"""Values of the units `host/...`, as ratios; below unchanged."""
_HOST: Mapping[str, Metric] = {
    "load_per_core": metrics.LOAD,
    "memory_available_bytes": metrics.MEMORY_FREE,
    "temperature_c": metrics.TEMPERATURE,
}
_CONTAINER: Mapping[str, Metric] = {
    "cpus_used": metrics.CONTAINER_CPUS,
    "cpu_limit": metrics.CONTAINER_CPU_LIMIT,
    "memory_bytes": metrics.CONTAINER_MEMORY,
    "memory_limit_bytes": metrics.CONTAINER_MEMORY_LIMIT,
    "pids": metrics.CONTAINER_PIDS,
    "pids_limit": metrics.CONTAINER_PIDS_LIMIT,
}
_TOPIC: Mapping[str, Metric] = {
    "hz": metrics.TOPIC_RATE,
    "expected_hz": metrics.TOPIC_EXPECTED,
    "silent_s": metrics.TOPIC_SILENT,
}


def build_page(context: ReporterContext, counts: EventCounts) -> MetricsPage:
    """Takes a few milliseconds; may be called by any thread."""
    page = MetricsPage(metrics.ALL)
    states = context.states()
    agent = context.settings.agent
    page.add(metrics.INFO, 1, agent.name, agent.id, __version__)
    page.add(metrics.ALIVE, context.alive())
    page.add(metrics.HOLDS, len(context.holds()))
    _levels(page, states)
    _faults(page, metrics.FAULTS_OPEN, context.open_faults(), states)
    _faults(page, metrics.FAULTS_GIVEN_UP, context.given_up(), states)
    counts.add_to(page, context.clock.mono())
    _not_yet(page, states)
    for state in states:
        result = context.newest(state.unit) or state.result
        _measurements(page, state, result.values)
    _heartbeats(page, context)
    _own(page, context)
    return page


def _levels(page: MetricsPage, states: tuple[UnitState, ...]) -> None:
    """A unit whose check had nothing to evaluate has no level."""
    slots = worst_by_slot(states)
    page.add(metrics.STATUS_WORD, status_word.encode(slots))
    for slot, level in sorted(slots.items()):
        page.add(metrics.SLOT_LEVEL, level, slot_name(slot))
    for state in states:
        if not state.not_applicable:
            page.add(metrics.UNIT_LEVEL, state.level, state.unit, slot_name(state.slot))


def _faults(page: MetricsPage, metric: Metric, faults: Iterable[Fault], states: tuple[UnitState, ...]) -> None:
    """The number of faults by slot, 0 for slots without one."""
    found = dict.fromkeys((slot_name(slot) for slot in sorted({state.slot for state in states})), 0)
    for fault in faults:
        found[slot_name(fault.slot)] = found.get(slot_name(fault.slot), 0) + 1
    for name, count in found.items():
        page.add(metric, count, name)


def _not_yet(page: MetricsPage, states: tuple[UnitState, ...]) -> None:
    """0 for what has not happened yet: the first one would otherwise be no increase."""
    for slot in sorted({state.slot for state in states}):
        page.add(metrics.ALARMS, 0, slot_name(slot))
        for outcome in metrics.OUTCOMES:
            page.add(metrics.FAULTS, 0, slot_name(slot), outcome.value)


# ------------------------------------------------------------ measurements of checks


def _measurements(page: MetricsPage, state: UnitState, values: Values) -> None:
    part = state.unit.partition("/")[2]
    if state.layer is Layer.CUSTOM:
        for name, value in values.items():
            page.add(metrics.CUSTOM, number(value), state.unit, name)
    elif state.check == "host":
        _host(page, values)
    elif state.check == "pressure":
        _container(page, part, values)
    elif state.check == "rates":
        _each(page, _TOPIC, values, f"/{part}" if not part.startswith("/") else part)


def _each(page: MetricsPage, table: Mapping[str, Metric], values: Values, *labels: str) -> None:
    for name, metric in table.items():
        if name in values:
            page.add(metric, number(values[name]), *labels)


def _host(page: MetricsPage, values: Values) -> None:
    _each(page, _HOST, values)
    for name, value in values.items():
        what, _, path = name.partition(" ")
        if name in _PERCENT:
            page.add(_PERCENT[name], ratio(value))
        elif what == "disk_percent":
            page.add(metrics.DISK_RATIO, ratio(value), path)
        elif what == "disk_free_bytes":
            page.add(metrics.DISK_FREE, number(value), path)
        elif what == "disk_total_bytes":
            page.add(metrics.DISK_SIZE, number(value), path)


def _container(page: MetricsPage, container: str, values: Values) -> None:
    _each(page, _CONTAINER, values, container)
    page.add(metrics.CONTAINER_THROTTLED, ratio(values.get("throttled_percent")), container)
    for resource in ("cpu", "memory", "io"):
        page.add(metrics.CONTAINER_WAITING, ratio(values.get(f"{resource}_waiting_percent")), container, resource)


# ------------------------------------------------------------ links


def _heartbeats(page: MetricsPage, context: ReporterContext) -> None:
    probe = context.links
    if probe is None:
        return
    ground, autopilot = probe.gcs(), probe.autopilot()
    if ground is not None:
        page.add(metrics.HEARTBEAT_AGE, ground.age_s, "ground", ground.link)
    if autopilot is not None:
        page.add(metrics.HEARTBEAT_AGE, autopilot.age_s, "autopilot", autopilot.link)
        if context.autopilot is None or context.autopilot():
            page.add(metrics.AUTOPILOT_ARMED, autopilot.armed)
    for link in probe.links():
        page.add(metrics.LINK_OPEN, link.open, link.name)
        page.add(metrics.LINK_AGE, link.rx_age_s, link.name)
        for sender in link.senders:
            page.add(metrics.LINK_LOSS, ratio(sender.loss_percent), link.name, sender.system, sender.component)
    for radio in probe.radios():
        page.add(metrics.RADIO_AGE, radio.age_s, radio.link)
        page.add(metrics.RADIO_SIGNAL, radio.rssi, radio.link, "local")
        page.add(metrics.RADIO_SIGNAL, radio.remrssi, radio.link, "remote")
        page.add(metrics.RADIO_NOISE, radio.noise, radio.link, "local")
        page.add(metrics.RADIO_NOISE, radio.remnoise, radio.link, "remote")
        page.add(metrics.RADIO_BUFFER, radio.txbuf / 100, radio.link)


# ------------------------------------------------------------ PHM itself


def _own(page: MetricsPage, context: ReporterContext) -> None:
    health: Mapping[str, Any] = context.health()
    page.add(metrics.UPTIME, health.get("uptime_s"))
    page.add(metrics.LATE, ratio(health.get("late_percent")))
    page.add(metrics.OVERDUE, len(health.get("overdue", ())))
    page.add(metrics.PROBLEMS, len(health.get("problems", ())))
    page.add(metrics.ROS_RESTARTS, health.get("ros_restarts"))
    for link in health.get("links", ()):
        page.add(metrics.LINK_SENT, link["bytes_out"], link["name"])
        page.add(metrics.LINK_RECEIVED, link["bytes_in"], link["name"])
    for name, (waiting, dropped) in context.queues().items():
        page.add(metrics.QUEUE, waiting, name)
        page.add(metrics.DROPPED, dropped, name)
    page.add(metrics.THREADS, threading.active_count())
    memory, cpu = _children()
    page.add(metrics.CHILDREN, memory)
    page.add(metrics.CHILDREN_CPU, cpu)


def _children() -> tuple[int, float]:
    """Resident memory and CPU seconds of the child processes that run now."""
    memory, cpu = 0, 0.0
    for child in psutil.Process().children(recursive=True):
        try:
            with child.oneshot():
                times = child.cpu_times()
                memory += child.memory_info().rss
                cpu += times.user + times.system
        except psutil.Error:
            continue  # it has ended
    return memory, cpu
