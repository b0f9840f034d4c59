"""Every module can be imported: `scripts/test` runs only a part of the tests on other Pythons than that of .venv."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOT_EVERYWHERE = frozenset(("diagnostic_msgs", "duckdb", "mcap", "pyarrow", "rcl_interfaces", "rclpy", "std_msgs"))
"""ROS, and what the extra `report` installs."""

IMPORTS = """
import importlib, sys
for name in sys.argv[2:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in sys.argv[1].split(","):
            raise
"""


def modules(source: Path, package: str) -> list[str]:
    """The names of the modules of a package, without those that are programs."""
    files = [file.relative_to(source).with_suffix("") for file in (source / package).rglob("*.py")]
    return sorted(".".join(file.parts).removesuffix(".__init__") for file in files if file.name != "__main__")


@pytest.mark.parametrize(("source", "package"), [(ROOT, "phm"), (ROOT / "checks", "phm_checks"), (ROOT, "sitl")])
def test_every_module_can_be_imported(source: Path, package: str) -> None:
    """On each Python, in one process."""
    names = modules(source, package)
    assert len(names) > 20
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS, ",".join(NOT_EVERYWHERE), *names],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'checks'}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
