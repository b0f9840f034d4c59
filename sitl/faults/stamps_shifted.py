"""The stamps in the messages of a topic are an hour ahead."""

from __future__ import annotations

from sitl.faults._reading import ReadingFault


class Injection(ReadingFault):
    """Has node_1 stamp its readings with a clock that is an hour ahead."""

    name, title = "stamps_shifted", "timestamps an hour ahead"
    condition = "data_stamp"
    cause = "a sensor with its own clock uses another time zone or lost its time"
    evidence, evidence_s = "the first message with such a stamp", 0.1
    evidence_period_s = 0.1
    signal_number = "40"
