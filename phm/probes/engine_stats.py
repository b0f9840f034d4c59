"""Converts the engine's statistics of a container to a fact, if the host's cgroups are not mounted into PHM."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phm.facts import ContainerFact, PressureFact
from phm.probes.cgroups import NEAR_LIMIT, less_cache

SOURCE = "engine statistics"
NOT_SEEN = ("waiting for CPU, memory and disk", "refused processes")


def pressure_fact(answer: Mapping[str, Any], container: ContainerFact, at: float) -> PressureFact | None:
    """The fact from a response of `GET /containers/ID/stats`, received at monotonic second `at`; None if the container
    does not run."""
    cpu, memory, pids = _part(answer, "cpu_stats"), _part(answer, "memory_stats"), _part(answer, "pids_stats")
    used_ns = _number(_part(cpu, "cpu_usage").get("total_usage"))
    if not used_ns:
        return None
    throttling, details = _part(cpu, "throttling_data"), _part(memory, "stats")
    # The statistics of a container without a limit have the memory of the machine as its limit.
    used, limit = _number(memory.get("usage")), container.memory_limit
    throttled_ns = _number(throttling.get("throttled_time"))
    return PressureFact(
        at,
        SOURCE,
        container.generation,
        NOT_SEEN,
        cpu_limit=container.cpu_limit,
        cpu_used_s=used_ns / 1e9,
        cpu_period_s=container.cpu_period_s,
        throttled_periods=_number(throttling.get("throttled_periods")),
        throttled_s=None if throttled_ns is None else throttled_ns / 1e9,
        memory_bytes=used,
        without_cache_bytes=_without_cache(details, used),
        memory_limit=limit,
        reread_pages=_reread(details, used, limit),
        pids=_number(pids.get("current")),
        pids_limit=_pids_limit(pids),
    )


def _reread(details: Mapping[str, Any], used: int | None, limit: int | None) -> int | None:
    """As in `phm.probes.cgroups`. The statistics of version 1 have no refaults: far below the limit, faults are first
    loads."""
    if used is None or limit is None or used < NEAR_LIMIT * limit:
        return None
    faults, refaults = _number(details.get("pgmajfault")), _number(details.get("workingset_refault"))
    return faults if faults is None or not refaults else min(faults, refaults)


def _without_cache(details: Mapping[str, Any], used: int | None) -> int | None:
    return less_cache(used, {name: count for name in details if (count := _number(details[name])) is not None})


def _pids_limit(pids: Mapping[str, Any]) -> int | None:
    """0 and the largest number mean no limit."""
    limit = _number(pids.get("limit"))
    return limit if limit is not None and 0 < limit < 1 << 32 else None


def _part(answer: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = answer.get(key)
    return part if isinstance(part, Mapping) else {}


def _number(value: Any) -> int | None:
    """A count; None for other values, because statistics of an older engine or kernel lack some."""
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None
