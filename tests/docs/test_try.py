"""scripts/try works as described in the README: without Docker, and it leaves nothing behind."""

from __future__ import annotations

import os
import socket
import subprocess

import pytest

from tests.docs.examples import ROOT

SECONDS = 25
LIMIT_S = 120


def free_base() -> int:
    """A port below a range of ports that are probably free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return min(port, 65000)


@pytest.mark.long
def test_three_agents_report_to_the_ground() -> None:
    """`phm gcs` receives every agent, and the processes end with the script."""
    base = free_base()
    environment = {**os.environ, "PHM_TRY_BASE": str(base), "PHM_GCS_PORT": str(base + 20)}
    done = subprocess.run(
        [str(ROOT / "scripts" / "try"), str(SECONDS)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for agent in ("A01", "A02", "A03"):
        assert f"{agent} ACTIVE" in done.stdout or f"{agent} OK" in done.stdout
    commands = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, timeout=10, check=True).stdout
    assert f"127.0.0.1:{base + 1}" not in commands
