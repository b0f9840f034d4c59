"""Faults that PHM may know of late: it waits before it reports them, or the Docker Engine does."""

from __future__ import annotations

LATE_S = {"container_created": 65.0, "healthcheck_hangs": 35.0}
"""PHM's wait for a first start with a period of the check; the engine's timeout of a HEALTHCHECK, 30 s, with one of its period."""


def known_s(fault: str, evidence_s: float | None) -> float:
    """Until when PHM may know of a fault, in seconds after its injection."""
    return (evidence_s or 0.0) + LATE_S.get(fault, 0.0)
