"""A callback of a node blocks for half a minute."""

from __future__ import annotations

from sitl.faults._node_signal import NodeSignal


class Injection(NodeSignal):
    """Has a callback of node_1 sleep for 30 s, as one that waits for a service or a disk does; then the node goes on. PHM does not
    wait for that: it restarts a node that neither runs nor computes."""

    name, title, unit = "callback_blocked", "callback blocks for 30 s", "nodes/{agent}/node_1"
    condition, earlier = "node_hung", "node_blocked"
    layer = "ros"
    cause = "a callback waits for a device, a disk or a service that does not answer"
    evidence, evidence_s = "the next message of its topic is missing", 0.2
    evidence_period_s = 0.2
    signal_number = "37"
