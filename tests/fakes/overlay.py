"""A new virtual environment that has all packages of this one, PHM among them, and room for more."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

LIMIT_S = 120.0
ROOT = Path(__file__).resolve().parents[2]


def make(folder: Path) -> dict[str, str]:
    """Make the environment; return variables with which its programs run, pip without network and build environment."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=LIMIT_S)
    (packages,) = folder.glob("lib/python*/site-packages")
    ours = [sysconfig.get_path("purelib"), str(ROOT), str(ROOT / "checks")]
    lines = [f"import site; site.addsitedir({ours[0]!r})", *ours[1:]]
    (packages / "of_phm.pth").write_text("\n".join(lines) + "\n")
    for program, module in (("phm", "phm.cli"), ("pip", "pip"), ("pytest", "pytest")):
        script = folder / "bin" / program
        script.write_text(f'#!/bin/sh\nexec "{folder}/bin/python" -m {module} "$@"\n')
        script.chmod(0o755)
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PHM_", "PYTEST"))}
    return {
        **inherited,
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "VIRTUAL_ENV": str(folder),
        "PIP_NO_INDEX": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this one inverted: no isolation
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
