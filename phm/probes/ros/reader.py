"""The raw subscription of one topic: the only place where samples are taken."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

from phm.probes.ros.message_taker import NO_SEQUENCE, RclTaker
from phm.probes.ros.message_types import UnknownType, load_type
from phm.probes.ros.rates.publisher_stats import Sample


@dataclass(frozen=True, slots=True)
class SubscriptionQos:
    """How to subscribe. depth: samples kept in the queue, and taken per poll.

    Without `latched` it is best effort and volatile, which by the rules of DDS is compatible with every publisher,
    causes no retransmissions and blocks no publisher. `latched` is reliable and transient local, which is needed to
    receive earlier samples and compatible only with publishers that are both.
    """

    depth: int = 1
    latched: bool = False


class RawMessage(NamedTuple):
    """A serialized message. writer: identity of its publisher; None: unknown. received_ns: by the system clock of this machine.
    sequence: number of the publication; None if the middleware gives none."""

    data: bytes
    writer: bytes | None
    received_ns: int
    sequence: int | None


class Reader:
    """Opened for a type, closed by `close`. Raises only UnknownType for an unexpected type."""

    identified = True
    """Whether rclpy gives the identity of publishers (from Kilted on), as far as is known."""

    def __init__(self, node: Any, topic: str, type_name: str, qos: SubscriptionQos, *, keep: bool = False) -> None:
        """keep: the messages of the newest poll are kept. Raises UnknownType."""
        self.qos = qos
        self.messages: list[RawMessage] = []
        self._keep = keep
        self._rcl: RclTaker | None = None
        self._tried = False
        self._node = node
        try:
            publishers = node.get_publishers_info_by_topic(topic)
        except Exception:  # rclpy and pybind: another participant may announce anything
            publishers = ()
        message = load_type(type_name, publishers)
        try:
            self._subscription = node.create_subscription(message, topic, _never_called, _profile(qos), raw=True)
        except Exception as error:  # rclpy raises its own and pybind's exceptions for broken type support
            raise UnknownType(f"type unknown: {type_name} cannot be subscribed to ({error})") from error
        if keep and not Reader.identified:
            with self._subscription.handle:
                self._identify()
        # Not in Humble.
        self._count = getattr(self._subscription, "get_publisher_count", None)

    def take(self, now_s: float) -> list[Sample]:
        """Samples since the last poll, oldest first."""
        samples = []
        self.messages = []
        handle = self._subscription.handle
        with handle:
            for _ in range(self.qos.depth):
                taken = handle.take_message(self._subscription.msg_type, True) if self._rcl is None else self._by_rcl()
                if taken is None:
                    break
                sample = _sample(taken, now_s)
                samples.append(sample)
                if self._keep:
                    self._keep_message(taken, sample)
        return samples

    def _identify(self) -> None:
        self._tried = True
        self._rcl = RclTaker.opened(self._subscription.handle.pointer)

    def _by_rcl(self) -> tuple[bytes, dict[str, Any]] | None:
        """In rclpy's form; the identity apart, because the rate of a topic must not depend on whether its data are examined."""
        assert self._rcl is not None
        taken = self._rcl.take()
        if taken is None:
            return None
        data, info = taken
        sequence = int(info.publication)
        return data, {
            "source_timestamp": int(info.source_ns),
            "received_timestamp": int(info.received_ns),
            "publication_sequence_number": None if sequence == NO_SEQUENCE else sequence,
            "writer": bytes(info.gid),
        }

    def _keep_message(self, taken: tuple[bytes, Any], sample: Sample) -> None:
        data, info = taken
        writer = sample.writer or info.get("writer")
        if writer is None and not self._tried:
            Reader.identified = False
            self._identify()
            if self._rcl is not None:
                return  # it would count as one of another publisher than those that follow
        received_ns = int(info.get("received_timestamp") or time.time_ns())
        self.messages.append(RawMessage(data, writer, received_ns, sample.sequence))

    @property
    def matched(self) -> int | None:
        """Number of publishers that the middleware has connected; None if unknown."""
        return None if self._count is None else self._count()

    def close(self) -> None:
        if self._rcl is not None:
            self._rcl.close()
        self._node.destroy_subscription(self._subscription)


def _profile(qos: SubscriptionQos) -> Any:
    from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

    reliable, kept = QoSReliabilityPolicy.RELIABLE, QoSDurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=reliable if qos.latched else QoSReliabilityPolicy.BEST_EFFORT,
        durability=kept if qos.latched else QoSDurabilityPolicy.VOLATILE,
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
