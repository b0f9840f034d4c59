"""What may fail in the simulated agent of `tests/fakes/agent_world.py`: the units, how each cause shows, and what repairs it."""

from __future__ import annotations

from phm.core.model import Level, Result

TARGET = "ros_app"
OK = Result(Level.OK, "healthy")
NODES = {n: f"nodes/agent_1/node_{n}" for n in (1, 2, 3)}
TOPICS = {n: f"topics/agent_1/topic_{n}" for n in (1, 2, 3)}
RATES = {n: f"rates/agent_1/topic_{n}" for n in (1, 2, 3)}
CAUSES = {
    "container": ("container/ros_app", "exited"),
    "paused": ("container/ros_app", "paused"),
    "unhealthy": ("health/ros_app", "unhealthy"),
    "network": ("network/ros_app", "disconnected"),
    "apart": ("network/ros_app", "sidecar_disconnected"),
    "file": ("files/ros_app", "file_missing"),
    "device": ("devices/ros_app", "device_missing"),
    "disk": ("host/disk", "disk_full"),
    "engine": ("engine", "engine_down"),
    **{f"node_{n}": (NODES[n], "node_missing") for n in NODES},
    **{f"silent_{n}": (RATES[n], "topic_silent") for n in RATES},
    "quorum": ("consensus", "quorum_dead"),
    "starved": ("pressure/ros_app", "cpu_throttled"),
    "overload": ("host/cpu", "cpu_high"),
}
"""Primary faults: the unit that is the cause, and its condition."""
LINKS = (("autopilot", "autopilot_silent"), ("gcs", "gcs_lost"), ("link/ground", "link_silent"))
STARVING = frozenset({"starved", "overload"})
HIDDEN = frozenset({"unhealthy", "quorum", *(kind for kind in CAUSES if kind.startswith("silent"))})
"""What cannot be known while the container is starved: it would look the same without its own cause."""
FIXES = {
    "start": {"container"},
    "unpause": {"paused"},
    "reconnect": {"network"},
    "join_network": {"apart"},
    "restore_file": {"file"},
    "relaunch": {"node_1", "node_2", "node_3", "silent_1", "silent_2", "silent_3"},
    "restart": set(CAUSES) - {"file", "device", "disk", "engine", "apart", *STARVING},
}
UNEXPLAINED = CAUSES.keys() - HIDDEN - {"overload"}
"""Whose process is gone: starvation does not explain it."""
LOST = "lost"
"""Not a cause: nodes that a repair has left cut off."""
BY_ENGINE = ("container/", "health/", "files/", "network/")
"""Units whose state the engine knows."""
BY_KERNEL = ("container/", "network/")
"""Those whose state the kernel shows in part, too."""
