"""Detection compared with the earliest moment at which anything on board could know of the fault. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.settings import HostSettings, PressureSettings, RosSettings
from phm_checks import _data_path, _endpoint_history, pressure, topics
from sitl.campaign.metrics import ClassMetrics, Figures

RATIO = 2.0
"""A class above this needs an explanation."""
_DATA_PATH = (
    "all nodes of the container must be silent for 1 s and again 0.4 s later (3 s without beacons): one lost message "
    "or a busy machine is not a blocked network"
)
_SILENCE = "a topic may pause for `ros.silence`, for less where it never paused for long: lost samples are not a fault"
_REMADE = f"a node may recreate its endpoint: {_endpoint_history.SETTLE_S:g} s where the node ran on meanwhile, else {topics.SETTLE_S:g} s"
_WINDOW = (
    "the container's counters are compared over `pressure.window`, once a second: a start or a burst is not a fault"
)
_DISK = f"waiting for the disk is measured over {pressure.IO_S:g} s, once a second: a burst of writes is not a fault"
_PIDS = "the container's counters are read once a second"
_FULL_CPU = "the CPU must be full for `host.cpu_quick`, measured once a second: shorter peaks are normal"
SNAPSHOTS_S = 0.5
"""Two snapshots of the ROS graph, which come four times a second: the evidence may just miss the first."""
READ_S = 1.0
"""Counters of the kernel are read once a second."""
_EXECUTOR = "an executor must not have run for 5 s while its process uses no CPU: a long callback is not a fault"
_PROCESS = (
    "PHM asks the engine for the processes when more than two heartbeats of a beacon, one every 0.2 s, are missing: it "
    "is not informed of their end"
)
_HEARTBEATS = "two heartbeats more than were ever missed must be missing: one lost frame is not a fault"
_ORDER = "measured from the order, and the engine needs most of this time to carry it out"
_REMOVAL = (
    "its end by a signal may be the beginning of `docker rm -f` or of a restart: PHM waits up to 0.5 s for what follows"
)
_PHM_DOWN = "nothing of PHM runs until Docker has restarted its container and Python has started"


@dataclass(frozen=True)
class Explanation:
    """Why a class is detected later than twice its limit; it explains a ratio of at most `up_to`."""

    words: str
    up_to: float


@dataclass(frozen=True)
class Wait:
    """A wait that follows from the configuration or a constant of PHM. limit_s: the fault's limit, on average; waits_s: how long PHM
    waits after its evidence, at the longest.
    """

    words: str
    limit_s: float
    waits_s: float

    @property
    def explanation(self) -> Explanation:
        return Explanation(self.words, round((self.limit_s + self.waits_s) / self.limit_s, 1))


_DATA_PATH_S = _data_path.SOON_S + _data_path.CONFIRM_S + SNAPSHOTS_S
_WINDOW_S = PressureSettings().window + READ_S
WAITS = {
    "address_silent": Wait(_DATA_PATH, 0.1, _DATA_PATH_S),
    "cpu_limited": Wait(_WINDOW, 0.25, _WINDOW_S),
    "disk_slow": Wait(_DISK, 1.0, pressure.IO_S + READ_S),
    "host_overload": Wait(_FULL_CPU, 2.0, HostSettings().cpu_quick + READ_S),
    "memory_tight": Wait(_WINDOW, 1.0, _WINDOW_S),
    "network_blocked": Wait(_DATA_PATH, 0.1, _DATA_PATH_S),
    "pids_exhausted": Wait(_PIDS, 0.1, READ_S),
    "subscriber_lost": Wait(_REMADE, 0.3, topics.SETTLE_S + SNAPSHOTS_S),
    "topic_silent": Wait(_SILENCE, 0.1, RosSettings().silence + SNAPSHOTS_S),
}
"""By fault."""
EXPLANATIONS = {
    **{name: wait.explanation for name, wait in WAITS.items()},
    "autopilot_reboot": Explanation(_HEARTBEATS, 6),
    "autopilot_silent": Explanation(_HEARTBEATS, 6),
    "callback_blocked": Explanation(_EXECUTOR, 70),
    "container_killed": Explanation(_REMOVAL, 8),
    "container_stopped": Explanation(_REMOVAL, 8),
    "crash_loop": Explanation(_REMOVAL, 8),
    "cpu_hog": Explanation("two seconds of full use: shorter peaks are normal", 3.5),
    "disk_full": Explanation("the free share is read once a second", 3),
    "executor_deadlocked": Explanation(_EXECUTOR, 70),
    "file_altered": Explanation(_ORDER, 5),
    "file_deleted": Explanation(_ORDER, 5),
    "file_not_executable": Explanation(_ORDER, 5),
    "gcs_radio_cut": Explanation(
        "the radio reports the loss of the other one 3.4 s after its last packet (SiK firmware)", 10
    ),
    "memory_full": Explanation("measured from the order to fill it, and filling 2 GB takes most of the time", 3),
    "memory_leak": Explanation(_PROCESS, 8),
    "netns_owner_killed": Explanation(_REMOVAL, 8),
    "node_duplicate": Explanation(
        "a restarted node may overlap with the old one for 2 s, unless both send beacons", 25
    ),
    "node_killed": Explanation(_PROCESS, 8),
    "node_never_started": Explanation("the time in which the other nodes started", 4),
    "node_stopped": Explanation(_PROCESS, 8),
    "overload_node_killed": Explanation(_PROCESS, 8),
    "peer_lost": Explanation(_HEARTBEATS, 5),
    "peer_split": Explanation(_HEARTBEATS, 5),
    "phm_killed": Explanation(_PHM_DOWN, 30),
    "phm_killed_in_restart": Explanation(_PROCESS, 8),
    "phm_state_noise": Explanation(_PHM_DOWN, 30),
    "power_loss": Explanation(_PHM_DOWN, 50),
    "router_killed": Explanation(_REMOVAL, 8),
    "sigterm_ignored": Explanation(_PROCESS, 8),
    "topic_slow": Explanation(
        "a rate must be wrong in two measurements, made once a second: jitter is not a fault", 12
    ),
    "transport_blocked": Explanation(_DATA_PATH, 20),
}
"""By fault. `up_to` is the longest time that the words and the measurements allow, divided by the limit."""
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Compared:
    """One class. `latest_s`: the evidence, at the latest; `limit_s`: on average. `ratio`: detection by the limit, mean of the
    injections, behind an outage of the engine by its end; None where one of them is not known.
    """

    title: str
    evidence: str
    latest_s: float | None
    limit_s: float | None
    detection_s: float | None
    ratio: float | None
    words: str
    """Explanation, or UNEXPLAINED; empty where none is needed."""


def compared(found: Figures) -> list[Compared]:
    """Every injected class, the largest ratio first."""
    rows = [_of_class(each) for each in found.classes]
    return sorted(rows, key=lambda row: (-(row.ratio or 0.0), row.title))


def _of_class(each: ClassMetrics) -> Compared:
    ratio, limit_s = each.evidence_ratio, None
    if each.evidence_s is not None:
        limit_s = each.evidence_s - each.evidence_period_s / 2
    words = "" if ratio is None or ratio <= RATIO else _explained(each.fault, ratio)
    return Compared(each.title, each.evidence, each.evidence_s, limit_s, each.detection.mean, ratio, words)


def _explained(fault: str, ratio: float) -> str:
    known = EXPLANATIONS.get(fault)
    return UNEXPLAINED if known is None or ratio > known.up_to else f"{known.words} (up to {known.up_to:g})"
