"""A node's executor is deadlocked: its other threads, among them its beacon's, go on."""

from __future__ import annotations

from sitl.faults._node_signal import NodeSignal


class Injection(NodeSignal):
    """Has a callback of node_1 wait for a lock that it holds itself. The beacon goes on and reports how long the executor has not
    run; the process uses no processor time, and it does not end at SIGTERM."""

    name, title, unit = "executor_deadlocked", "executor deadlocked, its heartbeat alive", "nodes/{agent}/node_1"
    condition, earlier = "node_hung", "node_blocked"
    layer = "ros"
    cause = "a callback waits for a lock that is never released, while other threads go on"
    evidence, evidence_s = "the next message of its topic is missing", 0.2
    evidence_period_s = 0.2
    signal_number = "36"
