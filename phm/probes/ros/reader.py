"""The raw subscription of one topic: the only place where samples are taken."""

from __future__ import annotations

from typing import Any

from phm.probes.ros.message_types import UnknownType, load_type
from phm.probes.ros.track import Sample

DEEP = 1000
"""Queue for middleware without sequence numbers: 4 kHz at four looks a second."""


class Reader:
    """The raw subscription of one topic. Opened on a type, closed by `close`; never raises for a strange type."""

    def __init__(self, node: Any, topic: str, type_name: str, *, deep: bool = False) -> None:
        """Raises UnknownType."""
        from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

        self.type_name = type_name
        self._node = node
        self._deep = deep
        message = load_type(type_name, node.get_publishers_info_by_topic(topic))
        # Best effort and volatile match every publisher; a queue of one keeps the middleware's copy small.
        qos = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=DEEP if deep else 1,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
            durability=QoSDurabilityPolicy.VOLATILE,
        )
        try:
            self._subscription = node.create_subscription(message, topic, _never_called, qos, raw=True)
        except Exception as error:  # rclpy raises its own and pybind's kinds for broken type support
            raise UnknownType(f"type unknown: {type_name} cannot be subscribed to ({error})") from error

    def take(self, now_s: float) -> list[Sample]:
        """What arrived since the last look: at most one sample, or all of them in a deep queue."""
        samples = []
        handle = self._subscription.handle
        with handle:
            for _ in range(DEEP if self._deep else 1):
                taken = handle.take_message(self._subscription.msg_type, True)
                if taken is None:
                    break
                samples.append(_sample(taken[1], now_s))
        return samples

    @property
    def needs_depth(self) -> bool:
        return not self._deep

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _never_called(_: object) -> None:
    """rclpy wants a callback; without an executor nobody calls it."""


def _sample(info: Any, now_s: float) -> Sample:
    """Humble's information has no sequence number, Jazzy's no writer."""
    gid = info.get("publisher_gid")
    if isinstance(gid, dict):
        gid = gid.get("data")
    writer = bytes(gid) if gid else None
    return Sample(info.get("publication_sequence_number"), int(info["source_timestamp"]), now_s, writer)
