"""What actions learn from the running daemon."""

from __future__ import annotations

from pathlib import Path

from phm.runtime.wiring import build_daemon
from phm.testing import FakeClock, settings


def test_a_container_that_has_got_a_stop_signal_must_not_be_restarted(tmp_path: Path) -> None:
    """Its processes may need long to end, and until then the engine calls it running."""
    daemon = build_daemon(
        settings(
            state_dir=str(tmp_path / "state"),
            run_dir=str(tmp_path / "run"),
            log={"directory": str(tmp_path / "log")},
            containers=[{"name": "app", "recover": True}],
        ),
        FakeClock(),
    )
    on_hold = daemon.components.action_context.on_hold
    assert on_hold("app") == ""
    daemon.components.pipeline.expect_stop("app", 60.0)
    assert on_hold("app") == "being stopped"
    daemon.components.pipeline.container_ended("app")
    assert on_hold("app") == ""
