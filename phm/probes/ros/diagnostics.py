"""ROS diagnostics in the child: receives the application's statuses and publishes PHM's.

Names and texts come from outside: they are counted and cut. `docs/reference/ros.md` states what is published as a
contract.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from phm.facts.ros import CONSENSUS, DIAGNOSTICS, DiagnosticFact
from phm.probes.ros.diagnostic_sources import key_of, name_of
from phm.probes.ros.message_taker import MessageTaker, Taken, by_rcl
from phm.probes.ros.protocol import LogText, Message, Publish, SelfReportUpdate

OWN_STATUS_PREFIX = "phm/"
"""Statuses with this prefix are PHM's, of this agent or another."""
MAX_TAKES = 50
"""Arrays read from one topic per poll; the reader's queue has the same length, and older ones are overwritten."""
MAX_BYTES = 200_000
"""Longest array in bytes that is read: 500 statuses of a few hundred bytes. Python needs about 10 ms for one."""
MAX_STATUSES = 500
PORTION = 75_000
"""Characters in one message to the daemon: JSON writes one beyond U+FFFF with twelve bytes, which makes 900 kB of LINE_LIMIT."""
_REST = 10
"""What a text costs besides its characters, counted as characters: JSON's quotes and separators, and numbers."""
MAX_REMARKS = 20
MAX_TEXT = 255
MAX_VALUES = 32
ACKNOWLEDGED_S = 0.5
"""Deadline for the acknowledgments of the last arrays: a subscriber may have lost its link."""
_FRAME = b"phm"
"""`header.frame_id` of PHM's own arrays, by which they are recognized before decoding."""
_MISSING = (
    "diagnostic_msgs is not installed beside PHM: /diagnostics is neither read nor published; "
    "install it where rclpy comes from (ros-<distro>-diagnostic-msgs)"
)


class DiagnosticsListener:
    """Readers of the diagnostic topics, and the publisher, created when there is something to publish.

    None of them is in an executor: the queues are emptied once per tick.
    """

    def __init__(self, node: Any, listen: Sequence[str], is_own: Callable[[str], bool] = lambda name: False) -> None:
        """is_own: whether a status of this name is configured; these are kept first."""
        self._node = node
        self._is_own = is_own
        self._log_texts: list[Message] = []
        self._said: set[str] = set()
        self._readers: dict[str, Any] = {}
        self._takers: dict[str, Callable[[], Taken | None]] = {}
        self._publishers: dict[str, Any] = {}
        self._published: dict[str, dict[str, tuple[DiagnosticFact, Any]]] = {}
        """The newest array of each topic, by status name: most are unchanged, and a message costs more than a comparison."""
        self._kinds: Any = None
        self._missing = False
        if listen and self._load():
            self._readers = {topic: self._reader(topic) for topic in listen}
            self._takers = {topic: _taker(reader) for topic, reader in self._readers.items()}

    def poll(self) -> list[Message]:
        """The newest status of each source received since the last poll."""
        received: dict[str, DiagnosticFact] = {}
        for topic, reader in self._readers.items():
            for array, writer in self._arrays(topic, reader):
                for status in array.status[:MAX_STATUSES]:
                    if status.name and not status.name.startswith(OWN_STATUS_PREFIX):
                        fact = _fact(status)
                        received[key_of(status.name[:MAX_TEXT], fact.hardware_id, writer)] = fact
        messages, self._log_texts = self._log_texts, []
        kept = sorted(received.items(), key=lambda item: not self._is_own(name_of(item[0])))[:MAX_STATUSES]
        return [*messages, *portions(kept)]

    def publish(self, order: Publish) -> None:
        """Publish PHM's own state, reliable and with a queue of one, as diagnostic_updater does."""
        if order.topic not in (DIAGNOSTICS, CONSENSUS) or not self._load():
            return
        if order.topic not in self._publishers:
            self._publishers[order.topic] = self._node.create_publisher(self._kinds.DiagnosticArray, order.topic, 1)
        self._publishers[order.topic].publish(self._array(order))

    def idle(self) -> tuple[str, ...]:
        """The topics whose publisher exists and has no subscriber but PHM's own reader: no array is needed there."""
        return tuple(
            topic
            for topic, publisher in self._publishers.items()
            if publisher.get_subscription_count() <= (topic in self._readers)
        )

    def close(self) -> None:
        """Wait until the subscribers have received the last arrays: the middleware discards what is not acknowledged with
        its publisher.
        """
        if not self._publishers:
            return
        from rclpy.duration import Duration

        end_s = time.monotonic() + ACKNOWLEDGED_S
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, end_s - time.monotonic())))

    def _load(self) -> bool:
        if self._kinds is None and not self._missing:
            try:
                import diagnostic_msgs.msg as kinds
                from rclpy.type_support import check_for_type_support

                check_for_type_support(kinds.DiagnosticArray)  # also loads the types of its fields, such as std_msgs
            except ImportError:
                self._missing = True
                self._say(_MISSING)
            else:
                self._kinds = kinds
        return self._kinds is not None

    def _say(self, text: str) -> None:
        """Report a text in the log once, up to a limit: some contain received data."""
        if text not in self._said and len(self._said) < MAX_REMARKS:
            self._said.add(text)
            self._log_texts.append(LogText(text))

    def _reader(self, topic: str) -> Any:
        from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

        # Best effort and volatile match every publisher.
        qos = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=MAX_TAKES,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
            durability=QoSDurabilityPolicy.VOLATILE,
        )
        return self._node.create_subscription(self._kinds.DiagnosticArray, topic, _never_called, qos, raw=True)

    def _arrays(self, topic: str, reader: Any) -> Iterable[tuple[Any, bytes | None]]:
        """The messages in the queue with their writers, up to MAX_BYTES; the rest waits for the next poll.

        Taken as bytes first: arrays that are too long, and PHM's own, are never decoded.
        """
        from rclpy.serialization import deserialize_message

        left = MAX_BYTES
        with reader.handle:
            for _ in range(MAX_TAKES):
                taken = self._takers[topic]() if left > 0 else None
                if taken is None:
                    return
                data, writer, _ = taken
                if len(data) > MAX_BYTES:
                    self._say(f"an array of more than {MAX_BYTES // 1000} kB on {topic} is ignored")
                elif not _own(data):
                    left -= len(data)
                    try:
                        yield deserialize_message(data, reader.msg_type), writer
                    except Exception as error:  # exceptions of rclpy and pybind: what was sent is not an array
                        self._say(f"a message on {topic} cannot be decoded: {error}")

    def _array(self, order: Publish) -> Any:
        array = self._kinds.DiagnosticArray()
        seconds = int(order.utc_s)
        array.header.stamp.sec = seconds
        array.header.stamp.nanosec = int((order.utc_s - seconds) * 1e9)
        array.header.frame_id = _FRAME.decode()
        before = self._published.get(order.topic, {})
        newest = self._published[order.topic] = {}
        for name, fact in order.statuses.items():
            known = before.get(name)
            if known is None or known[0] != fact:
                known = (fact, self._status(name, fact))
            newest[name] = known
        array.status = [message for _, message in newest.values()]
        return array

    def _status(self, name: str, fact: DiagnosticFact) -> Any:
        values = [self._kinds.KeyValue(key=key, value=value) for key, value in fact.values.items()]
        level = bytes((fact.level,))
        return self._kinds.DiagnosticStatus(
            level=level, name=name, message=fact.message, hardware_id=fact.hardware_id, values=values
        )


def portions(statuses: Sequence[tuple[str, DiagnosticFact]]) -> list[Message]:
    """Split into messages that stay below LINE_LIMIT whatever their characters."""
    messages: list[Message] = []
    part: dict[str, DiagnosticFact] = {}
    size = 0
    for name, fact in statuses:
        own = _REST + len(name) + len(fact.message) + len(fact.hardware_id)
        own += sum(_REST + len(key) + len(value) for key, value in fact.values.items())
        if part and size + own > PORTION:
            messages.append(SelfReportUpdate(diagnostics=part))
            part, size = {}, 0
        part[name] = fact
        size += own
    return [*messages, SelfReportUpdate(diagnostics=part)] if part else messages


def _fact(status: Any) -> DiagnosticFact:
    values: Mapping[str, str] = {
        item.key[:MAX_TEXT]: item.value[:MAX_TEXT] for item in status.values[:MAX_VALUES] if item.key
    }
    return DiagnosticFact(0.0, status.level[0], status.message[:MAX_TEXT], status.hardware_id[:MAX_TEXT], values)


def _own(data: bytes) -> bool:
    """Whether a serialized array is PHM's: CDR header 4 bytes, stamp 8, length of frame_id 4 (with its final zero), text."""
    return data[12:16] == (len(_FRAME) + 1).to_bytes(4, "little") and data[16:20] == _FRAME + b"\0"


def _taker(reader: Any) -> Callable[[], Taken | None]:
    """Through rcl from the first message on: with two methods the identity of a writer would change."""
    with reader.handle:
        return by_rcl(reader.handle.pointer) or MessageTaker(reader).take


def _never_called(_: object) -> None:
    """rclpy requires a callback; without an executor it is never called."""
