"""The wheels of `runtime.lock`, so that a new environment with them costs no work with an index.

pip reads every file name that an index has of a package: for this lock that is most of its CPU time (33,000 names). So the
files are looked for once for a lock and a Python and kept in .cache. An installation compares their hashes with the lock again.
"""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / "scripts" / "locks" / "runtime.lock"
LIMIT_S = 300.0


def folder() -> Path:
    """A folder with these wheels and nothing else; those of an earlier lock are deleted."""
    digest = hashlib.sha256(LOCK.read_bytes()).hexdigest()[:12]
    prefix = f"runtime-wheels-{sys.implementation.cache_tag}-{platform.machine()}"
    kept = ROOT / ".cache" / f"{prefix}-{digest}"
    if not kept.exists():
        for old in kept.parent.glob(f"{prefix}-*"):
            shutil.rmtree(old, ignore_errors=True)
        kept.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent) as scratch:
            _download(Path(scratch, "wheels"))
            with suppress(OSError):  # another test process was faster, and its folder is the same
                Path(scratch, "wheels").rename(kept)
    assert kept.is_dir()
    return kept


def _download(target: Path) -> None:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary=:all:", "--require-hashes", "--requirement", str(LOCK), "--dest", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
