"""What figures were measured on, and PHM's processes there."""

from __future__ import annotations

import platform

import psutil

from sitl.faults.base import Agent


def machine() -> str:
    """Architecture, cores, memory and kernel of this machine."""
    cores, memory = psutil.cpu_count(), psutil.virtual_memory().total / 2**30
    return f"{platform.machine()}, {cores} cores, {memory:.0f} GiB, Linux {platform.release()}"


def processes(agent: Agent) -> list[psutil.Process]:
    """PHM's processes on this machine: the daemon and its ROS child (the container's init is not PHM's)."""
    top = agent.container("phm").top(ps_args="-eo pid,args")
    return [psutil.Process(int(row[0])) for row in top["Processes"] if "python" in row[1]]
