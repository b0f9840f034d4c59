"""Detection compared with the earliest moment at which anything on board could know of the fault. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from sitl.campaign.metrics import Figures, OfClass

FLOOR_S = 0.1
"""A shorter limit, e.g. of an event of the kernel, counts as this: a ratio of milliseconds says nothing."""
RATIO = 2.0
"""A class above this needs an explanation."""
EXPLANATIONS = {
    "autopilot_silent": "two heartbeats more than were ever missed must be missing: one lost frame is not a fault",
    "cpu_hog": "two seconds of full use: shorter peaks are normal",
    "gcs_radio_cut": "the radio reports the loss of the other one 3.4 s after its last packet (SiK firmware)",
    "memory_full": "measured from the order to fill it, and filling 2 GB takes most of the time",
    "node_never_started": "the time in which the other nodes started",
    "peer_lost": "heartbeats of all peers, one every 2 s: one lost frame is not a fault",
    "peer_split": "heartbeats of all peers, one every 2 s: one lost frame is not a fault",
    "topic_silent": "five or more periods of 5 Hz: fewer would raise alarms for lost samples",
    "topic_slow": "five or more periods of 5 Hz: fewer would raise alarms for lost samples",
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
