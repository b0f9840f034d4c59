"""`phm run` as a separate process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from phm.runtime.shutdown_marker import NAME as MARKER
from phm.wire import control
from tests.fakes.until import until

ROOT = Path(__file__).parents[2]
LIMIT_S = 60.0

# A busy machine may stop a process for seconds, and its limit for the end is not the subject of most tests.
PATIENT = """
from phm.runtime import service
service.END_S = 600.0
"""
RUN = """
import sys
from phm.cli import main
main(sys.argv[1:])
"""


class Running:
    """`phm run` with its own configuration."""

    def __init__(self, folder: Path, *before: str, **more: Any) -> None:
        self.folder = folder
        self.write(**more)
        self.process = self.another(*before)

    def write(self, **more: Any) -> None:
        places = {
            "state_dir": str(self.folder / "state"),
            "run_dir": str(self.folder / "run"),
            "log": {"directory": str(self.folder / "log")},
        }
        (self.folder / "phm.yaml").write_text(
            json.dumps({"agent": {"id": 1}, "checks": {"host": {"enabled": False}}, **places, **more})
        )

    def another(self, *before: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *(before or ("-c", PATIENT + RUN)), "run", "-c", str(self.folder / "phm.yaml")],
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks"))), "PHM_WATCHDOG": "off"},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    @property
    def marker(self) -> Path:
        return self.folder / "state" / MARKER

    def ready(self) -> None:
        until(lambda: (self.folder / "run" / control.NAME).exists() and self.marker.exists(), "the daemon")
