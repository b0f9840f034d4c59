"""A check without code fails in a real container: PHM restarts it if the entry says so, and only then."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phm.core.model import Fault, FaultClosed, FaultOpened, Outcome, Phase
from tests.proxy.haproxy import EngineAccess
from tests.recovery.test_recovery_real import Phm

RUN = "trap 'exit 0' TERM; touch /tmp/healthy; while :; do sleep 0.1; done"
# A busy engine may lose the output of a program that ends immediately.
CHECK = ["sh", "-c", "test -e /tmp/healthy && echo fine || { echo PUMP dry; sleep 0.5; exit 2; }"]


def entry(**more: Any) -> dict[str, Any]:
    return {
        "name": "pump", "type": "command", "command": CHECK, "container": "app", "period": "500ms", "timeout": "60s",
        "grace": 0, **more,
    }  # fmt: skip


def faults(phm: Phm, kind: type[FaultOpened] | type[FaultClosed]) -> list[Fault]:
    return [event.fault for event in list(phm.events) if isinstance(event, kind)]


def test_a_failed_check_restarts_its_container_only_on_request(
    real: Any, engine_access: EngineAccess, tmp_path: Path
) -> None:
    """Once as a fault without a target, and recovered with `recovery`; both directly and through the socket proxy."""
    app = real.container(RUN)
    containers = [{"name": app.name, "alias": "app", "recover": True, "address": False}]
    alone = entry(name="alone", command=[*CHECK[:2], CHECK[2].replace("healthy", "alone")])
    # A busy machine may start the container and its program seconds apart.
    recovered = entry(recovery={"container": "app"}, grace="15s")
    app.exec_run(["touch", "/tmp/alone"])
    phm = Phm(tmp_path, engine_access, containers, custom=[alone, recovered], verify="60s", limit_s=180.0)
    try:
        phm.start()
        app.exec_run(["rm", "/tmp/alone"])
        phm.until(lambda: faults(phm, FaultOpened), "the fault without recovery")
        app.exec_run(["rm", "/tmp/healthy"])
        phm.until(lambda: phm.count(Phase.VERIFIED) == 1, "the verified restart")
        assert [fault.unit for fault in faults(phm, FaultOpened)] == ["custom/alone", "custom/pump"], phm.seen()
        phm.until(lambda: faults(phm, FaultClosed), "the end of its fault")  # published once the container is released
        assert len(faults(phm, FaultClosed)) == 1, (faults(phm, FaultClosed), phm.seen())
        (closed,) = faults(phm, FaultClosed)
        assert (closed.unit, closed.outcome, closed.by) == ("custom/pump", Outcome.RESOLVED, "restart")
        assert (closed.result.condition, closed.result.target) == ("custom_failed", "app")
        assert closed.result.summary == "pump: PUMP dry" and closed.result.brief == "pump PUMP dry"
        assert [fault.unit for fault in phm.daemon.pipeline.open_faults()] == ["custom/alone"]
        assert phm.count(Phase.STARTED) == 1
    finally:
        phm.daemon.stop()
