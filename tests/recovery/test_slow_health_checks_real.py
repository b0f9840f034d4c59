"""Real HEALTHCHECKs of 30 s and 60 s on the real engine: a container that comes up is restarted once and verified."""

from __future__ import annotations

from typing import Any

import pytest

from phm.core.model import Phase
from tests.recovery.test_recovery_real import Phm, Start, phm

__all__ = ["phm"]

pytestmark = [pytest.mark.engine, pytest.mark.long]

SECOND = 10**9
READY = "/tmp/ready"
LIMIT_S = 600.0
"""Each container is probed several times in succession, and the machine may be busy."""


def healthcheck(interval_s: int, retries: int) -> dict[str, Any]:
    test = ["CMD", "test", "-e", READY]
    return {"test": test, "interval": interval_s * SECOND, "timeout": 60 * SECOND, "retries": retries}


def comes_up(after_s: int) -> str:
    """Ready this long after its start, until READY is removed."""
    return f"trap 'exit 0' TERM; rm -f {READY}; sleep {after_s} & wait $!; touch {READY}; while :; do sleep 1 & wait $!; done"


def phases(daemon: Phm, key: str) -> list[str]:
    return [phase for target, phase, _ in daemon.actions() if target == key]


def test_a_container_that_needs_longer_than_verify_is_restarted_once(real: Any, phm: Start) -> None:
    """One is found healthy by its first probe after a minute, the other by its second one after half a minute: both
    later than `recovery.verify`, until when Docker reports `starting`.
    """
    minute = real.container(comes_up(0), healthcheck=healthcheck(60, 1))
    half = real.container(comes_up(40), healthcheck=healthcheck(30, 2))
    made = {"minute": minute, "half": half}
    entries = [{"name": each.name, "alias": key, "recover": True} for key, each in made.items()]
    daemon = phm(entries, limit_s=LIMIT_S, verify="30s", same_failure=3, ladders={})
    for each in made.values():
        each.exec_run(["rm", READY])
    for key in made:
        daemon.until(lambda key=key: Phase.VERIFIED.value in phases(daemon, key), f"the verification of {key}")  # type: ignore[misc]
    for key, each in made.items():
        assert phases(daemon, key) == ["started", "done", "verified"]
        assert f"health/{key}" in daemon.opened()
        each.reload()
        assert each.attrs["State"]["Health"]["Status"] == "healthy"
    assert sorted(daemon.opened()) == ["health/half", "health/minute"]
