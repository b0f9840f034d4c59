"""Detection compared with the earliest moment at which anything on board could know of the fault. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from phm import beacon
from phm.core.settings import HostSettings, MavlinkSettings, PressureSettings, RosSettings
from phm.probes import inotify, link_radio
from phm.probes.ros.rates import estimator
from phm.recovery.holds import manual_stop
from phm.reporters import received_heartbeats
from phm.swarm import peers
from phm.tracker.tracker import ASK_AGAIN_S
from phm.transport.priority import default_periods
from phm_checks import (
    _data_path,
    _endpoint_history,
    _graph_evidence,
    _node_activity,
    _node_record,
    _process_table,
    container,
    files,
    nodes,
    pressure,
    rates,
    topics,
)
from sitl.campaign.metrics import ClassMetrics, Figures
from sitl.campaign.verdict import FLOOR_S
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.simulation import radio

RATIO = 2.0
"""A class above this needs an explanation."""
_DATA_PATH = (
    f"all nodes of the container must be silent for {_data_path.SOON_S:g} s and again {_data_path.CONFIRM_S:g} s later, where all have "
    "beacons and their processes sleep: one lost message is not a blocked network"
)
_AWAKE = (
    f"all nodes of the container must be silent together, for {_data_path.SOON_S:g} s and again {_data_path.CONFIRM_S:g} s later, or for "
    f"{_data_path.SILENT_S:g} s where one has no beacon or its process does not sleep: it may only wait for a CPU"
)
_SILENCE = "a topic may pause for `ros.silence`, for less where it never paused for long: lost samples are not a fault"
_REMADE = f"a node may recreate its endpoint: {_endpoint_history.SETTLE_S:g} s where the node ran on meanwhile, else {topics.SETTLE_S:g} s"
_WINDOW = (
    "the container's counters are compared over `pressure.window`, once a second: a start or a burst is not a fault"
)
_DISK = f"waiting for the disk is measured over {pressure.IO_S:g} s, once a second: a burst of writes is not a fault"
_PIDS = "the container's counters are read once a second"
_FULL_CPU = (
    "the CPU must be full for `host.cpu_quick`, measured once a second, or its mean over `host.cpu_window` where a container "
    "has just started: shorter peaks are normal"
)
SNAPSHOTS_S = 0.5
"""Two snapshots of the ROS graph, which come four times a second: the evidence may just miss the first."""
READ_S = 1.0
"""Counters of the kernel are read once a second."""
_EXECUTOR = (
    f"a beacon asks its executor to run once a second, and it counts as blocked {_graph_evidence.LATE_S:g} s after it should have, where "
    "its topics are silent too: a short delay is not a fault"
)
_EXECUTOR_S = _node_activity.TURN_S + _graph_evidence.LATE_S + READ_S
_PROCESS = (
    f"PHM asks the engine for the processes when {_graph_evidence.WAVER_PERIODS:g} heartbeats of a beacon, one every {beacon.PERIOD_S:g} s, "
    "are missing: it is not informed of their end"
)
_PROCESS_S = _graph_evidence.WAVER_PERIODS * beacon.PERIOD_S + nodes.Nodes.period_s
"""The last one came just before its end, and the check runs once more."""
_RATE = f"a rate is that of the last {estimator.WINDOW_S:g} s, and must be wrong in two measurements, made once a second: jitter is not a fault"
_UNSTARTED = (
    f"who created it may still start it, for {container.UNSTARTED_ALONE_S:g} s, e.g. `docker compose up`, and the check runs every "
    f"{container.Container.period_s:g} s"
)
HEALTHCHECK_S = 30.0
"""Timeout of the application's HEALTHCHECK in a swarm (docker/compose.swarm.yaml)."""
_HANGS = (
    f"the engine reports a run as failed when it has lasted for the timeout of the HEALTHCHECK, {HEALTHCHECK_S:g} s in a swarm, and "
    "nothing about one that has not ended"
)
_AUTOPILOT = "it is silent for `mavlink.autopilot_timeout`, for less where it never missed a heartbeat in two minutes: lost frames are not a fault"
_PEER = f"{peers.LOST_PERIODS:g} of its heartbeats must be missing, fewer where none or few were ever lost: one lost frame is not a fault"
_LEFT_OUT = (
    f"a node without a process was left out of a start after {_process_table.LATER:g} times its delay at an earlier one plus 1 s, and "
    "ages of processes are whole seconds: a slow start is not a fault"
)
_LOG = (
    "PHM reports the first line that it cannot write; with `interval` at 20 s, most often that is the one of received heartbeats, "
    f"every {received_heartbeats.WRITE_S:g} s"
)
_AGAIN = f"PHM asks the engine about the container, and again before it reports, at the latest {ASK_AGAIN_S:g} s later"
_FILE = f"it must last {files.SETTLE_S:g} s, as programs replace a file by another, and be found again, at the latest {ASK_AGAIN_S:g} s later"
_DUPLICATE = f"a restarted node may overlap with the old one for {_node_record.BOTH_S:g} s, unless both send beacons"
_REMOVAL = (
    f"its end by SIGKILL may be the beginning of `docker rm -f`: PHM waits {manual_stop.REMOVED_S:g} s for what follows, and "
    f"asks the engine again before it reports, at the latest {ASK_AGAIN_S:g} s later"
)


@dataclass(frozen=True)
class Explanation:
    """Why a class is detected later than twice its limit; it explains a ratio of at most `up_to`."""

    words: str
    up_to: float

    def __str__(self) -> str:
        return f"{self.words} (up to {self.up_to:g})"


@dataclass(frozen=True)
class Wait:
    """A wait that follows from the configuration or a constant of PHM, never from a measurement. waits_s: how long PHM waits after the
    fault's evidence, at the longest.
    """

    words: str
    waits_s: float

    def explanation(self, limit_s: float) -> Explanation:
        """limit_s: the fault's limit, on average."""
        return Explanation(self.words, round((limit_s + self.waits_s) / limit_s, 1))


_DATA_PATH_S = _data_path.SOON_S + _data_path.CONFIRM_S + SNAPSHOTS_S
_WINDOW_S = PressureSettings().window + READ_S
_FILE_S = inotify.GATHER_S + inotify.PACE_S + files.SETTLE_S + ASK_AGAIN_S
_REMOVAL_S = manual_stop.REMOVED_S + ASK_AGAIN_S
_AUTOPILOT_S = MavlinkSettings().autopilot_timeout - 1.0 + READ_S
"""It counts from the last heartbeat, the evidence is the next one, a second later."""
_PEER_S = (peers.LOST_PERIODS - 1) * default_periods(8)[0] + READ_S
WAITS = {
    "address_silent": Wait(_DATA_PATH, _DATA_PATH_S),
    "autopilot_reboot": Wait(_AUTOPILOT, _AUTOPILOT_S),
    "autopilot_silent": Wait(_AUTOPILOT, _AUTOPILOT_S),
    "callback_blocked": Wait(_EXECUTOR, _EXECUTOR_S),
    "clock_stepped": Wait("the clock is read once a second", READ_S),
    "container_killed": Wait(_REMOVAL, _REMOVAL_S),
    "container_created": Wait(_UNSTARTED, container.UNSTARTED_ALONE_S + container.Container.period_s),
    "container_stopped": Wait(_AGAIN, ASK_AGAIN_S),  # no `kill` of the engine: it may not be removed
    "cpu_hog": Wait(
        "ERROR needs `host.cpu` of 98 % in each of two seconds, or as the mean over `host.cpu_window`: shorter peaks are normal",
        HostSettings().cpu_window + READ_S,
    ),
    "cpu_limited": Wait(_WINDOW, _WINDOW_S),
    "crash_loop": Wait(_REMOVAL, _REMOVAL_S),
    "disk_full": Wait("the free share is read once a second", READ_S),
    "disk_slow": Wait(_DISK, pressure.IO_S + READ_S),
    "executor_deadlocked": Wait(_EXECUTOR, _EXECUTOR_S),
    "file_altered": Wait(_FILE, _FILE_S),
    "file_deleted": Wait(_FILE, _FILE_S),
    "file_not_executable": Wait(_FILE, _FILE_S),
    "gcs_radio_cut": Wait(
        f"a SiK radio reports the loss of the other one {radio.FORGETS_S:g} s after its last packet, once a second",
        radio.FORGETS_S + READ_S,
    ),
    "healthcheck_hangs": Wait(_HANGS, HEALTHCHECK_S - 1.0 + ASK_AGAIN_S),  # the limit is 1 s after its begin
    "host_overload": Wait(_FULL_CPU, HostSettings().cpu_window + READ_S),
    "log_read_only": Wait(_LOG, received_heartbeats.WRITE_S),
    "memory_full": Wait("the memory in use is read once a second", READ_S),
    "memory_leak": Wait(_PROCESS, _PROCESS_S),
    "memory_tight": Wait(_WINDOW, _WINDOW_S),
    "netns_owner_killed": Wait(_REMOVAL, _REMOVAL_S),
    "network_blocked": Wait(_DATA_PATH, _DATA_PATH_S),
    "network_disconnected": Wait(_AGAIN, ASK_AGAIN_S),
    "network_lost_together": Wait(_AGAIN, ASK_AGAIN_S),
    "network_recreated": Wait(_AGAIN, ASK_AGAIN_S),
    "node_duplicate": Wait(_DUPLICATE, _node_record.BOTH_S + SNAPSHOTS_S),
    "node_never_started": Wait(_LEFT_OUT, _process_table.LATER + 1.0 + _process_table.SOON_S),
    "node_killed": Wait(_PROCESS, _PROCESS_S),
    "node_stopped": Wait(_PROCESS, _PROCESS_S),
    "overload_node_killed": Wait(_PROCESS, _PROCESS_S),
    "peer_lost": Wait(_PEER, _PEER_S),
    "peer_split": Wait(_PEER, _PEER_S),
    "phm_killed_in_restart": Wait(_PROCESS, _PROCESS_S),
    "phm_stopped": Wait(
        "its watchdog must find it stopped twice, after 0.25 to 0.5 s: a short stop is not a fault", 0.375
    ),
    "pids_exhausted": Wait(_PIDS, READ_S),
    "qos_mismatch": Wait(
        f"the mismatch must last {topics.SURE_S:g} s and be found again, in snapshots of the graph four times a second",
        topics.SURE_S + SNAPSHOTS_S,
    ),
    "radio_lossy": Wait(
        f"damaged packets are counted over {link_radio.MEAN_OF} RADIO_STATUS, one a second: single ones are normal",
        link_radio.MEAN_OF - 1.0,
    ),
    "router_killed": Wait(_REMOVAL, _REMOVAL_S),
    "sidecar_disconnected": Wait(_AGAIN, ASK_AGAIN_S),
    "sigterm_ignored": Wait(_PROCESS, _PROCESS_S),
    "subscriber_lost": Wait(_REMADE, topics.SETTLE_S + SNAPSHOTS_S),
    "topic_silent": Wait(_SILENCE, RosSettings().silence + SNAPSHOTS_S),
    "topic_slow": Wait(_RATE, estimator.WINDOW_S + rates.CONFIRM_S),
    "transport_blocked": Wait(_AWAKE, _data_path.SILENT_S + SNAPSHOTS_S),
}
"""By fault."""


def _limit_s(fault: Fault) -> float:
    """On average."""
    return max((fault.evidence_s or 0.0) - fault.evidence_period_s / 2, FLOOR_S)


_FAULTS = all_faults()
EXPLANATIONS = {name: wait.explanation(_limit_s(_FAULTS[name])) for name, wait in WAITS.items()}
"""By fault. One that is later than this has none: no wait of PHM explains it, e.g. until Python has started again."""
UNEXPLAINED = "unexplained"


def known_s(fault: str, evidence_s: float | None) -> float:
    """Until when PHM may know of a fault, in seconds after its injection, by its waits alone."""
    return (evidence_s or 0.0) + (WAITS[fault].waits_s if fault in WAITS else 0.0)


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
        limit_s = round(each.evidence_s - each.evidence_period_s / 2, 3)
    words = "" if ratio is None or ratio <= RATIO else _explained(each, ratio)
    return Compared(each.title, each.evidence, each.evidence_s, limit_s, each.detection.mean, ratio, words)


def _explained(each: ClassMetrics, ratio: float) -> str:
    """By the words of the class; or these, where they are needed, for those that were not disturbed."""
    words = _known(each.fault, ratio)
    if words or not each.disturbed or each.undisturbed_ratio is None:
        return words or UNEXPLAINED
    alone = each.undisturbed_ratio
    words = _known(each.fault, alone)
    if alone > RATIO and not words:
        return UNEXPLAINED
    return f"{each.disturbed} of {each.compared} disturbed, the others {alone:.1f}{': ' if words else ''}{words}"


def _known(fault: str, ratio: float) -> str:
    known = EXPLANATIONS.get(fault)
    return "" if ratio <= RATIO or known is None or ratio > known.up_to else str(known)
