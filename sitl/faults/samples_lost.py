"""Half of the samples of a sensor are lost before they are published."""

from __future__ import annotations

from sitl.faults._reading import ReadingFault


class Injection(ReadingFault):
    """Has the counter in the readings of node_1 leave out every second number, at the same rate of messages."""

    name, title = "samples_lost", "half of the samples lost"
    condition = "data_gaps"
    healable = False
    cause = "a bus or radio between sensor and driver loses every second sample"
    evidence, evidence_s = "the first message whose counter leaves out a number", 0.1
    evidence_period_s = 0.1
    signal_number = "41"
