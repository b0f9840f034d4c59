"""What `scripts/proof` plays: which faults, in which order, under which configuration of PHM."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from sitl.faults.file_deleted import CONTENT
from sitl.harness.config_overrides import overridden

MODES = ("act", "off", "advise")
ORDER = (
    "container_stopped", "network_disconnected", "container_killed", "unhealthy", "container_paused", "node_killed",
    "container_oom", "file_deleted", "node_stopped", "file_not_executable", "topic_silent", "device_gone",
    "topic_slow", "sidecar_disconnected", "two_at_once", "address_silent", "device_replugged", "container_created", "file_altered",
    "crash_loop",
)  # fmt: skip
"""Neighbours break different units, so that no fault is taken for the return of the one before it."""
APART = ("netns_owner_killed",)
"""Each needs its own configuration: played after the others, alone."""
CAMPAIGN = (
    "autopilot_reboot", "autopilot_silent", "callback_blocked", "clock_stepped", "cpu_hog", "data_frozen", "disk_full",
    "engine_restarted", "executor_deadlocked", "gcs_radio_cut", "healthcheck_hangs", "log_read_only", "memory_full",
    "memory_leak", "network_blocked", "network_lost_together", "network_recreated", "node_duplicate",
    "node_never_started", "peer_lost", "peer_split", "phm_killed", "phm_killed_in_restart", "phm_state_noise",
    "phm_stopped", "power_loss", "qos_mismatch", "radio_lossy", "radio_saturated", "router_killed", "samples_lost",
    "sigterm_ignored", "stamps_shifted", "subscriber_lost", "transport_blocked",
)  # fmt: skip
"""Not played here: they are reported but not recovered, or need a swarm. `sitl.campaign` plays them; docs/development/sitl_faults.md."""
STARVING = (
    "cpu_limited", "memory_tight", "disk_slow", "pids_exhausted", "host_overload", "overload_node_killed",
    "overload_container_killed", "overload_ends",
)  # fmt: skip
"""Nor these: what they starve is judged by `sitl.bench.starvation`."""
LEFT_ALONE = ("node_killed", "network_disconnected", "container_stopped")
RELAUNCHED = "node_killed"
RELAUNCH = (
    '["ros-entrypoint", "python", "-m", "sitl.application.node", "--name", "node_1", "--namespace", "/agent_1", '
    '"--publish", "topic_1:10", "--subscribe", "topic_3"]'
)


@dataclass(frozen=True)
class Play:
    """Faults played one after the other under one configuration; `apart`: it is that of the only fault."""

    mode: str
    faults: tuple[str, ...]
    relaunch: bool = False
    apart: bool = False

    @property
    def first(self) -> bool:
        """It needs the configuration with which the agent is started."""
        return self.mode == "act" and not self.relaunch and not self.apart


def plays(only: Collection[str] = (), modes: Collection[str] = MODES) -> Iterator[Play]:
    """The whole programme, or what of it has the faults in `only` and the modes in `modes`."""
    programme = (
        Play("act", ORDER),
        Play("act", (RELAUNCHED,), relaunch=True),
        *(Play("act", (name,), apart=True) for name in APART),
        *(Play(mode, LEFT_ALONE) for mode in MODES if mode != "act"),
    )
    for play in programme:
        names = tuple(name for name in play.faults if not only or name in only)
        if names and play.mode in modes:
            yield Play(play.mode, names, play.relaunch, play.apart)


def configuration(mode: str = "act", *, relaunch: bool = False, more: Mapping[str, str] | None = None) -> str:
    """The shipped configuration with room for so many faults in a row, files that can be judged and restored, and a pause that counts as a
    failure although the vehicle is disarmed."""
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    changes = {
        "\n  budget: 5": "\n  budget: 100",
        "\n  mode: act": f"\n  mode: {mode}",
        '#sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"': f'sha256: "{sha256}"',
        "#restore: image": "restore: image",
        "\n    ground: respect": "\n    ground: heal",
        **(more or {}),
    }
    if relaunch:
        changes["#relaunch: [ros2, run, my_package, node_1]"] = f"relaunch: {RELAUNCH}"
    return overridden(changes)
