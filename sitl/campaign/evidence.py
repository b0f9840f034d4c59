"""Detection compared with the earliest moment at which anything on board could know of the fault. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from sitl.campaign.metrics import Figures, OfClass

RATIO = 2.0
"""A class above this needs an explanation."""
_DATA_PATH = (
    "all nodes of the container must be silent for 1 s and again 0.4 s later (3 s without beacons): one lost message "
    "or a busy machine is not a blocked network"
)
_FIVE_PERIODS = "five periods without a message, measured once a second: fewer would raise alarms for lost samples"
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


EXPLANATIONS = {
    "address_silent": Explanation(_DATA_PATH, 10),
    "autopilot_reboot": Explanation(_HEARTBEATS, 6),
    "autopilot_silent": Explanation(_HEARTBEATS, 6),
    "callback_blocked": Explanation(_EXECUTOR, 70),
    "container_killed": Explanation(_REMOVAL, 8),
    "container_stopped": Explanation(_REMOVAL, 8),
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
    "network_blocked": Explanation(_DATA_PATH, 10),
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
    "power_loss": Explanation(_PHM_DOWN, 50),
    "router_killed": Explanation(_REMOVAL, 8),
    "sigterm_ignored": Explanation(_PROCESS, 8),
    "topic_silent": Explanation(_FIVE_PERIODS, 20),
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


def _of_class(each: OfClass) -> Compared:
    ratio, limit_s = each.evidence_ratio, None
    if each.evidence_s is not None:
        limit_s = each.evidence_s - each.evidence_period_s / 2
    words = "" if ratio is None or ratio <= RATIO else _explained(each.fault, ratio)
    return Compared(each.title, each.evidence, each.evidence_s, limit_s, each.detection.mean, ratio, words)


def _explained(fault: str, ratio: float) -> str:
    known = EXPLANATIONS.get(fault)
    return UNEXPLAINED if known is None or ratio > known.up_to else f"{known.words} (up to {known.up_to:g})"
