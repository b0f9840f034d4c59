"""Prints the ROS installation that PHM would use, as JSON, for `phm doctor`: `python -m phm.probes.ros.installation`.

A separate process, since loading the middleware may hang or crash. Fails with ImportError where there is no rclpy.
"""

from __future__ import annotations

import json
import os
import re
import sys
from functools import partial
from importlib import metadata
from pathlib import Path

_VERSION = re.compile(r"<version[^>]*>\s*([\w.+~-]+)\s*</version>")
MAX_MANIFEST = 64 * 1024


def main() -> None:
    import rclpy

    wheels = _wheels("rclpy")
    middleware = rclpy.get_rmw_implementation_identifier()
    found = {
        "distribution": os.environ.get("ROS_DISTRO") or next((name for name in wheels if name), ""),
        "rclpy": next(iter(wheels.values()), "") or _version("rclpy"),
        "middleware": middleware,
        "middleware_version": package_version(middleware),
    }
    sys.stdout.write(json.dumps(found) + "\n")


def package_version(package: str) -> str:
    """Version of a ROS package: of its wheel, else of its package.xml in AMENT_PREFIX_PATH; empty if neither is found."""
    wheel = next(iter(_wheels(package).values()), "")
    return wheel or next(filter(None, map(partial(_manifest_version, package), _prefixes())), "")


def _wheels(package: str) -> dict[str, str]:
    """Versions of a ROS package that pip installed as `ros-DISTRIBUTION-PACKAGE` or `ros-PACKAGE`, by distribution."""
    wheel = re.compile(rf"ros-(?:(\w+)-)?{re.escape(package.replace('_', '-'))}")
    found = {}
    for one in metadata.distributions():
        match = wheel.fullmatch((one.metadata["Name"] or "").lower().replace("_", "-"))
        if match:
            found[match[1] or ""] = one.version
    return found


def _prefixes() -> list[str]:
    return [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]


def _manifest_version(package: str, prefix: str) -> str:
    try:
        with Path(prefix, "share", package, "package.xml").open(encoding="utf-8", errors="replace") as file:
            match = _VERSION.search(file.read(MAX_MANIFEST))
    except OSError:
        return ""
    return match[1] if match else ""


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


if __name__ == "__main__":
    main()
