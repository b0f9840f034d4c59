"""Detection compared with the earliest moment at which anything on board could know of the fault. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from sitl.campaign.metrics import Figures, OfClass

FLOOR_S = 0.1
"""A shorter limit, e.g. of an event of the kernel, counts as this: a ratio of milliseconds says nothing."""
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
EXPLANATIONS = {
    "address_silent": _DATA_PATH,
    "autopilot_reboot": _HEARTBEATS,
    "autopilot_silent": _HEARTBEATS,
    "callback_blocked": _EXECUTOR,
    "cpu_hog": "two seconds of full use: shorter peaks are normal",
    "disk_full": "the free share is read once a second",
    "executor_deadlocked": _EXECUTOR,
    "gcs_radio_cut": "the radio reports the loss of the other one 3.4 s after its last packet (SiK firmware)",
    "memory_full": "measured from the order to fill it, and filling 2 GB takes most of the time",
    "memory_leak": _PROCESS,
    "network_blocked": _DATA_PATH,
    "node_duplicate": "a restarted node may overlap with the old one for 2 s, unless both send beacons",
    "node_killed": _PROCESS,
    "node_never_started": "the time in which the other nodes started",
    "node_stopped": _PROCESS,
    "overload_node_killed": _PROCESS,
    "peer_lost": _HEARTBEATS,
    "peer_split": _HEARTBEATS,
    "phm_killed": "nothing of PHM runs until Docker has restarted its container and Python has started",
    "sigterm_ignored": _PROCESS,
    "topic_silent": _FIVE_PERIODS,
    "topic_slow": "a rate must be wrong in two measurements, made once a second: jitter is not a fault",
    "transport_blocked": _DATA_PATH,
}
"""Why a class is detected later than twice its limit."""
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Compared:
    """One class. `ratio`: mean detection by the limit; None where one of them is not known."""

    title: str
    evidence: str
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
    ratio = None
    if each.evidence_s is not None and each.detection.mean is not None:
        ratio = each.detection.mean / max(each.evidence_s, FLOOR_S)
    late = ratio is not None and ratio > RATIO
    words = EXPLANATIONS.get(each.fault, UNEXPLAINED) if late else ""
    return Compared(each.title, each.evidence, each.evidence_s, each.detection.mean, ratio, words)
