"""Faults that PHM may know of late: it waits before it reports them, or the Docker Engine does."""

from __future__ import annotations

from phm_checks.container import UNSTARTED_ALONE_S, Container
from phm_checks.health import Health

TIMEOUT_S = 30.0
"""The engine's, of the application's HEALTHCHECK."""
LATE_S = {
    "container_created": UNSTARTED_ALONE_S + Container.period_s,
    "healthcheck_hangs": TIMEOUT_S + Health.period_s,
}


def known_s(fault: str, evidence_s: float | None) -> float:
    """Until when PHM may know of a fault, in seconds after its injection."""
    return (evidence_s or 0.0) + LATE_S.get(fault, 0.0)
