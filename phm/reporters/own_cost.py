"""What PHM itself costs: CPU time and memory of the daemon and its child processes, and bytes sent, for the log."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import psutil


def own_cost(health: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of the event `cost`. health: `ReporterContext.health()`, for the counters of the links.

    cpu_s: since the start, child processes that have ended included. memory_bytes: proportional set size, so that memory
    that processes share counts once; resident set size of a process whose maps the kernel does not show.
    """
    daemon = psutil.Process()
    own = daemon.cpu_times()
    cpu_s = own.user + own.system + own.children_user + own.children_system
    memory, processes = _memory(daemon), 1
    for child in daemon.children(recursive=True):
        try:
            times = child.cpu_times()
            cpu_s += times.user + times.system
            memory += _memory(child)
            processes += 1
        except psutil.Error:
            continue  # it has ended: its CPU time is in that of the daemon
    return {
        "cpu_s": round(cpu_s, 2),
        "memory_bytes": memory,
        "processes": processes,
        "threads": threading.active_count(),
        "sent_bytes": {str(link["name"]): int(link.get("bytes_out", 0)) for link in health.get("links", ())},
    }


def _memory(process: psutil.Process) -> int:
    try:
        return int(process.memory_full_info().pss)
    except (psutil.Error, AttributeError):
        return int(process.memory_info().rss)
