"""A message package that only the application has, in its own directory with the layout of colcon's merged `install/`.

PHM's own environment has no sensor_msgs; `environ` adds it to one process. The directory is created once, from the locked
wheel, for any distribution and any Python, and kept in .cache.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "sensor_msgs"
LIMIT_S = 120.0
OWN_PYTHON = f"{sys.version_info[0]}.{sys.version_info[1]}"
OWN_DISTRIBUTION = "kilted" if Path(sys.prefix, "lib", "libfastdds.so").exists() else "jazzy"
"""Of the environment that runs the tests; Jazzy's Fast DDS has another name."""
OTHER_DISTRIBUTION = {"jazzy": "kilted", "kilted": "jazzy"}[OWN_DISTRIBUTION]


def install(distribution: str, python: str = OWN_PYTHON) -> Path:
    """The directory with sensor_msgs of `jazzy` or `kilted` for a version of Python such as 3.12."""
    lock = ROOT / "scripts" / "locks" / f"app-{distribution}.lock"
    digest = hashlib.sha256(lock.read_bytes()).hexdigest()[:12]
    folder = ROOT / ".cache" / f"app-{distribution}-{python}-{digest}"
    if not folder.exists():
        folder.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            _unpack(_download(lock, python, Path(scratch)), python, Path(scratch, "install"))
            with suppress(OSError):  # another test process was faster, and its directory is the same
                Path(scratch, "install").rename(folder)
    assert folder.is_dir()
    return folder


def environ(base: Mapping[str, str], folder: Path, python: str = OWN_PYTHON) -> dict[str, str]:
    """`base`, as after `source install/setup.bash`, for a process with its own ROS wheels."""
    # Variables that the ROS wheels set for the test process, and only in the first process of all.
    libraries = [part for part in base.get("LD_LIBRARY_PATH", "").split(os.pathsep) if part]
    others = [part for part in libraries if not Path(part).is_relative_to(sys.prefix)]
    modules = [str(folder / "lib" / f"python{python}" / "site-packages"), base.get("PYTHONPATH", "")]
    return {
        **{name: value for name, value in base.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"},
        "PYTHONPATH": os.pathsep.join(filter(None, modules)),
        "LD_LIBRARY_PATH": os.pathsep.join([str(folder / "lib"), *others]),
    }


def isolated(merged: Path, folder: Path, python: str = OWN_PYTHON) -> Path:
    """The default layout of colcon on Debian: a prefix for each package, modules under local/."""
    prefix = folder / PACKAGE
    modules = prefix / "local" / "lib" / f"python{python}" / "dist-packages"
    shutil.copytree(merged / "lib" / f"python{python}" / "site-packages", modules)
    (prefix / "lib").mkdir()
    for library in (merged / "lib").glob("*.so"):
        shutil.copy(library, prefix / "lib")
    return folder


def _download(lock: Path, python: str, scratch: Path) -> Path:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary=:all:", "--python-version", python, "--require-hashes", "--requirement", str(lock)]
    done = subprocess.run(
        [*command, "--dest", str(scratch)], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = scratch.glob("*.whl")
    return wheel


def _unpack(wheel: Path, python: str, folder: Path) -> None:
    """Unpack like pip with a prefix; pip itself does so only for its own Python."""
    modules = folder / "lib" / f"python{python}" / "site-packages"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(modules)
    (data,) = modules.glob("*.data")
    shutil.copytree(data / "data", folder, dirs_exist_ok=True)
    shutil.rmtree(data)
