"""Message packages from the application's own `install/` folder, as colcon creates it, mounted into PHM.

Only what a type needs is loaded, when it is needed: with the folder in PYTHONPATH and LD_LIBRARY_PATH, an application
with another ROS distribution would replace PHM's own rclpy. Runs only in the child.
"""

from __future__ import annotations

import ctypes
import importlib
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from phm.probes.ros.opaque_types import TypeUnavailable

PYTHON = f"{sys.version_info[0]}.{sys.version_info[1]}"
_LAYOUTS = ("lib/python{}/site-packages", "local/lib/python{}/dist-packages", "lib/python{}/dist-packages")
"""Where ament installs modules: in general, and with Debian's Python."""
_VERSION = re.compile(r"/lib/python(3\.\d+)/")
_MISSING = re.compile(r"^([^:/]+\.so[.\d]*): cannot open shared object file")
_OF_MESSAGES = re.compile(r"lib[a-z0-9_]+__rosidl_[a-z_]+\.so")


class MountedPackages:
    """The folders of `ros.installs`, merged (`install/lib`) or isolated (`install/PACKAGE/lib`)."""

    def __init__(self, installs: Iterable[str]) -> None:
        self._installs = [Path(install) for install in installs if install]

    def holds(self, folder: str) -> bool:
        """Whether one of these contains a folder. After `load` Python finds their packages too, but not all of their
        libraries."""
        return any(Path(folder).is_relative_to(install) for install in self._installs)

    def load(self, package: str, kind: str, short: str) -> Any:
        """The class of `package/kind/short`. Raises NotHere."""
        if not self._installs:
            raise TypeUnavailable(
                "ros.installs names no folder with it (mount the application's install/ and name it there)"
            )
        try:
            return self._loaded(package, kind, short)
        except TypeUnavailable:
            raise
        except Exception as error:  # folders that cannot be read; modules that raise exceptions while they are imported
            raise TypeUnavailable(f"ros.installs has it, but it cannot be loaded ({error})") from error

    def _loaded(self, package: str, kind: str, short: str) -> Any:
        self._demand_package(package)
        # At the end: what is installed beside PHM has priority.
        sys.path += [folder for folder in self._python_folders() if folder not in sys.path]
        importlib.invalidate_caches()
        self._load_libraries(package)
        _demand_same_generation(package, kind, short)
        return _with_support(package, kind, short)

    def _demand_package(self, package: str) -> None:
        found = [
            folder / package
            for prefix in self._prefixes()
            for layout in _LAYOUTS
            for folder in prefix.glob(layout.format("3*"))
            if (folder / package / "__init__.py").is_file()
        ]
        if not found:
            raise TypeUnavailable(f"none of the folders of ros.installs has {package}")
        versions = sorted({match[1] for path in found if (match := _VERSION.search(path.as_posix()))})
        if PYTHON not in versions:
            raise TypeUnavailable(
                f"ros.installs has it for Python {' and '.join(versions)}, while PHM runs Python {PYTHON}"
            )

    def _prefixes(self) -> Iterator[Path]:
        for install in self._installs:
            yield install
            yield from sorted(install.glob("*/"))

    def _python_folders(self) -> list[str]:
        return [
            str(folder)
            for prefix in self._prefixes()
            for layout in _LAYOUTS
            if (folder := prefix / layout.format(PYTHON)).is_dir()
        ]

    def _load_libraries(self, package: str) -> None:
        """Load the libraries with their dependencies in other packages. The modules then find them by name."""
        folders = [folder for prefix in self._prefixes() if (folder := prefix / "lib").is_dir()]
        for folder in folders:
            for path in sorted(folder.glob(f"lib{package}__rosidl_*.so")):
                if not path.stem.endswith("_cpp"):
                    _load(path, folders)


def _load(path: Path, folders: list[Path], depth: int = 0) -> None:
    """Load one library, after those that it depends on. Raises NotHere."""
    for _ in range(200):
        try:
            ctypes.CDLL(str(path))
            return
        except OSError as error:
            missing = _MISSING.match(str(error))
            if missing is None or depth > 50:
                raise TypeUnavailable(f"ros.installs has it, but it cannot be loaded ({error})") from error
        name = missing[1]
        found = [folder / name for folder in folders if (folder / name).is_file()]
        if not found or not _OF_MESSAGES.fullmatch(name):
            raise TypeUnavailable(
                f"ros.installs has it, but {path.name} needs {name}, which PHM's ROS lacks: it was built for another"
            )
        _load(found[0], folders, depth + 1)


def _demand_same_generation(package: str, kind: str, short: str) -> None:
    """From Iron on each type has a hash, and the middleware calls for it; a type without one would crash this process."""
    theirs = ctypes.CDLL(f"lib{package}__rosidl_generator_c.so")
    if not hasattr(theirs, f"{package}__{kind}__{short}__init"):
        raise TypeUnavailable(f"ros.installs has {package}, but without this type")
    ours = ctypes.CDLL("librcl_interfaces__rosidl_generator_c.so")
    if hasattr(ours, "rcl_interfaces__msg__Log__get_type_hash") != hasattr(
        theirs, f"{package}__{kind}__{short}__get_type_hash"
    ):
        raise TypeUnavailable("ros.installs has it, but built for another ROS distribution than PHM's")


def _with_support(package: str, kind: str, short: str) -> Any:
    from rclpy.type_support import check_is_valid_msg_type

    message = getattr(importlib.import_module(f"{package}.{kind}"), short)
    check_is_valid_msg_type(message)
    return message
