"""Prints the ROS installation that PHM would use, as JSON, for `phm doctor`: `python -m phm.probes.ros.installation`.

A separate process, since loading the middleware may hang or crash. Fails with ImportError where there is no rclpy.
"""

from __future__ import annotations

import json
import os
import re
import sys
from importlib import metadata

_WHEEL = re.compile(r"ros-(?:(\w+)-)?rclpy")


def main() -> None:
    import rclpy

    wheels = _wheels()
    found = {
        "distribution": os.environ.get("ROS_DISTRO") or next((name for name in wheels if name), ""),
        "rclpy": next(iter(wheels.values()), "") or _version("rclpy"),
        "middleware": rclpy.get_rmw_implementation_identifier(),
    }
    sys.stdout.write(json.dumps(found) + "\n")


def _wheels() -> dict[str, str]:
    """Versions of rclpy that pip installed as `ros-DISTRIBUTION-rclpy` or `ros-rclpy`, by distribution."""
    found = {}
    for one in metadata.distributions():
        match = _WHEEL.fullmatch((one.metadata["Name"] or "").lower().replace("_", "-"))
        if match:
            found[match[1] or ""] = one.version
    return found


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


if __name__ == "__main__":
    main()
