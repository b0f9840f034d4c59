"""A topic has its rate and new stamps, and always the same value."""

from __future__ import annotations

from sitl.faults._reading import ReadingFault


class Injection(ReadingFault):
    """Has node_1 send its last value again and again, each time with a new stamp and number."""

    name, title = "data_frozen", "data frozen at the right rate"
    condition = "data_frozen"
    cause = "a driver publishes the last value of a sensor that has stopped measuring"
    evidence, evidence_s = "the first message with the value of the one before", 0.1
    evidence_period_s = 0.1
    signal_number = "39"
