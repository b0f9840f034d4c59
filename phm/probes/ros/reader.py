"""The raw subscription of one topic: the only place where samples are taken."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from phm.probes.ros.message_types import UnknownType, load_type
from phm.probes.ros.rates.publisher_stats import Sample


@dataclass(frozen=True, slots=True)
class Quality:
    """How to subscribe. depth: samples kept in the queue, and taken per look.

    Without `latched` it is best effort and volatile, which by the rules of DDS is compatible with every publisher,
    causes no retransmissions and blocks no publisher. `latched` is reliable and transient local, which is needed to
    receive earlier samples and compatible only with publishers that are both.
    """

    depth: int = 1
    latched: bool = False


class Reader:
    """Opened for a type, closed by `close`. Raises only UnknownType for an unexpected type."""

    def __init__(self, node: Any, topic: str, type_name: str, quality: Quality) -> None:
        """Raises UnknownType."""
        self.quality = quality
        self._node = node
        try:
            publishers = node.get_publishers_info_by_topic(topic)
        except UnicodeDecodeError:  # a name from an unknown participant
            publishers = ()
        message = load_type(type_name, publishers)
        try:
            self._subscription = node.create_subscription(message, topic, _never_called, _profile(quality), raw=True)
        except Exception as error:  # rclpy raises its own and pybind's exceptions for broken type support
            raise UnknownType(f"type unknown: {type_name} cannot be subscribed to ({error})") from error
        # Not in Humble.
        self._count = getattr(self._subscription, "get_publisher_count", None)

    def take(self, now_s: float) -> list[Sample]:
        """Samples since the last look, oldest first."""
        samples = []
        handle = self._subscription.handle
        with handle:
            for _ in range(self.quality.depth):
                taken = handle.take_message(self._subscription.msg_type, True)
                if taken is None:
                    break
                samples.append(_sample(taken, now_s))
        return samples

    @property
    def matched(self) -> int | None:
        """Number of publishers that the middleware has connected; None if unknown."""
        return None if self._count is None else self._count()

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


def _profile(quality: Quality) -> Any:
    from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

    reliable, kept = QoSReliabilityPolicy.RELIABLE, QoSDurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=reliable if quality.latched else QoSReliabilityPolicy.BEST_EFFORT,
        durability=kept if quality.latched else QoSDurabilityPolicy.VOLATILE,
    )


def _never_called(_: object) -> None:
    """rclpy requires a callback; without an executor it is never called."""


def _sample(taken: tuple[bytes, Any], now_s: float) -> Sample:
    """Humble's information has no sequence number, Jazzy's no writer."""
    data, info = taken
    gid = info.get("publisher_gid")
    if isinstance(gid, dict):
        gid = gid.get("data")
    source_ns = int(info["source_timestamp"])
    now_ns = time.time_ns()
    received_ns = int(info.get("received_timestamp") or now_ns)
    return Sample(
        info.get("publication_sequence_number"),
        source_ns,
        now_s,
        bytes(gid) if gid else None,
        len(data),
        (received_ns - source_ns) / 1e9,
        max(0.0, (now_ns - received_ns) / 1e9),
    )
