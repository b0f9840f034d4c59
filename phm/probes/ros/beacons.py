"""Receives beacons (`phm.beacon`) in the child and passes on the newest of each node.

Any participant may publish on this topic. `BeaconRegistry` decides what is kept.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from phm.beacon import BEACON, MAX_TEXT
from phm.probes.ros.beacon_registry import BeaconRegistry, portions
from phm.probes.ros.beacon_text import log_texts
from phm.probes.ros.graph import node_of
from phm.probes.ros.message_taker import GID_BYTES, MessageTaker, Taken
from phm.probes.ros.protocol import Message, SelfReportUpdate

MAX_TAKES = 250
"""Messages read per poll, four polls a second: enough for 200 processes with five heartbeats a second."""
MAX_BYTES = 2 * MAX_TEXT
OWN_BYTES = 100_000
"""Bytes read per poll from each writer of configured nodes' beacons."""
OTHERS_BYTES = 200_000
"""Bytes read per poll from all other writers together."""
SHORT_S = 1.0


class BeaconListener:
    """The reader, which is not in an executor: its queue is emptied once per tick.

    Writers of configured nodes' beacons come first, each with its own limit; all others share the rest.
    """

    def __init__(self, node: Any, nodes: frozenset[str]) -> None:
        from rcl_interfaces.msg import Log
        from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

        self._node, self._nodes = node, nodes
        self._registry = BeaconRegistry(nodes, self._listed)
        self._lost = False
        self._polled_s = time.monotonic()
        qos = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=MAX_TAKES,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
            durability=QoSDurabilityPolicy.VOLATILE,
        )
        self._reader = node.create_subscription(Log, BEACON, _never_called, qos, raw=True)
        self._taker = MessageTaker(self._reader)

    def poll(self) -> list[Message]:
        """Return the messages for the daemon; called once per tick."""
        now_s, wall_ns = time.monotonic(), time.time_ns()
        longest_s, self._polled_s = now_s - self._polled_s, now_s
        taken = self._take()
        # After a long pause the newest messages are enough; after a short one none may have been overwritten.
        self._lost = len(taken) >= MAX_TAKES and longest_s <= SHORT_S
        for data, writer, received_ns in self._chosen(taken):
            # The middleware's time stamp is of a clock that may be set: it is used only if plausible.
            age_s = min(max((wall_ns - received_ns) / 1e9, 0.0), longest_s)
            try:
                self._registry.add(*log_texts(data), now_s - age_s, writer)
            except (ValueError, struct.error):
                self._registry.refused += 1
        changes = self._registry.changes(now_s)
        if changes is None:
            return [SelfReportUpdate(refused=self._registry.refused, lost=True)] if self._lost else []
        return [*portions(replace(changes, lost=self._lost), self._nodes)]

    def _take(self) -> list[Taken]:
        """Messages since the last poll, oldest first, as bytes: messages that are too long are never decoded."""
        found = []
        with self._reader.handle:
            for _ in range(MAX_TAKES):
                taken = self._taker.take()
                if taken is None:
                    break
                found.append(taken)
        return found

    def _chosen(self, taken: Sequence[Taken]) -> list[Taken]:
        """The messages within the limits; the rest is counted as refused."""
        chosen = choose(taken, self._registry.own_writers())
        self._registry.refused += len(taken) - len(chosen)
        self._lost = self._lost or len(chosen) < sum(len(data) <= MAX_BYTES for data, _, _ in taken)
        return chosen

    def _listed(self) -> Mapping[bytes, str] | None:
        """The writers of beacons that discovery lists, with the names of their nodes; None if unknown."""
        try:
            infos = self._node.get_publishers_info_by_topic(BEACON)
        except Exception:  # a name that is not UTF-8
            return None
        return {bytes(info.endpoint_gid)[:GID_BYTES]: node_of(info) for info in infos}


def choose(taken: Sequence[Taken], own: Collection[bytes]) -> list[Taken]:
    """Messages of the writers in `own` first, up to OWN_BYTES each; then one of each other writer in turn, short ones
    first, up to OTHERS_BYTES together. Those of one writer keep their order."""
    spent: Counter[bytes | None] = Counter()
    turns: Counter[bytes | None] = Counter()
    first: list[Taken] = []
    others: list[tuple[int, int, int, Taken]] = []
    for message in taken:
        data, writer, _ = message
        if len(data) > MAX_BYTES:
            continue
        if writer in own and spent[writer] + len(data) <= OWN_BYTES:
            spent[writer] += len(data)
            first.append(message)
        else:
            others.append((turns[writer], len(data), len(others), message))
            turns[writer] += 1
    left = OTHERS_BYTES
    for _, size, _, message in sorted(others):
        left -= size
        if left < 0:
            break
        first.append(message)
    return first


def _never_called(_: object) -> None:
    """rclpy requires a callback; without an executor it is never called."""
