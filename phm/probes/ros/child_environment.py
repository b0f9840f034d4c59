"""The environment variables of the child process of the ROS probe: those of the interpreter, ROS and the middleware."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import phm
from phm.core.settings import RosSettings
from phm.probes.ros.protocol import INSTALLS

# Defaults that the environment may override.
_ENVIRONMENT = {
    # Two arenas instead of one for each of the middleware's threads: 10 MB less.
    "MALLOC_ARENA_MAX": "2",
    # numpy is part of rclpy's messages and would start a thread for each core.
    "OPENBLAS_NUM_THREADS": "1",
    # The sidecar shares no /dev/shm with the application: over shared memory topics are listed but no data arrive.
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
}

_VARIABLES = frozenset({"PATH", "HOME", "LANG", "LANGUAGE", "TZ", "CYCLONEDDS_URI", "OMP_NUM_THREADS"})
_PREFIXES = (
    "LC_",
    "LD_",
    "PYTHON",
    "ROS_",
    "RMW_",
    "RCL_",
    "RCUTILS_",
    "AMENT_",
    "COLCON_",
    "FASTDDS_",
    "FASTRTPS_",
    "ZENOH_",
    "MALLOC_",
    "OPENBLAS_",
    "PHM_ROS_",
    "PHM_DEBUG_ROS_",
)
"""Environment variables of the interpreter, ROS and the middleware; the child receives no others."""


def child_environ(ros: RosSettings, environ: Mapping[str, str]) -> dict[str, str]:
    """The variables that the child needs of the daemon's environment, which may contain secrets. Variables that are set
    have priority."""
    merged = {**_ENVIRONMENT, **{name: value for name, value in environ.items() if _needed(name)}}
    if ros.domain is not None:
        merged["ROS_DOMAIN_ID"] = str(ros.domain)
    merged[INSTALLS] = os.pathsep.join(ros.installs)
    # The child must run the same PHM, wherever the daemon found it.
    home = str(Path(phm.__file__).resolve().parent.parent)
    merged["PYTHONPATH"] = os.pathsep.join(part for part in (merged.get("PYTHONPATH", ""), home) if part)
    return merged


def _needed(name: str) -> bool:
    return name in _VARIABLES or name.startswith(_PREFIXES)
