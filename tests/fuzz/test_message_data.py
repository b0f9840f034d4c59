"""The messages of a topic whose data are examined: any participant of the domain can publish there."""

from __future__ import annotations

from hypothesis import strategies as st

from phm.facts.ros import TopicFact
from phm.probes.ros.data.data_monitor import DataMonitor
from phm.probes.ros.data.decoder import Decoded, Decoder
from phm.probes.ros.protocol import GraphMessage, WantedData, decode, encode
from phm.probes.ros.reader import RawMessage
from tests.fakes.ros_messages import stamped
from tests.fuzz.targets import fuzzed

NANOSECONDS = st.integers(-(2**31) * 10**9, (2**31) * 10**9 - 1)
MESSAGES = st.builds(
    RawMessage,
    st.binary(max_size=40) | st.builds(stamped, NANOSECONDS, st.binary(max_size=8), st.binary(max_size=8)),
    st.none() | st.sampled_from([b"1" * 16, b"2" * 16]),
    st.integers(0, 2**63 - 1),
    st.none() | st.integers(0, 9) | st.integers(0, 2**64 - 2),
)
COUNTERS = st.none() | st.integers(-(2**63), 2**64 - 1) | st.floats()


class Numbers(Decoder):
    """Decodes any message as the next of these values of a counter."""

    def __init__(self, counters: list[float | None], bits: int | None) -> None:
        super().__init__(WantedData(), "")
        self._counters, self.counter_bits = counters, bits

    @property
    def usable(self) -> bool:
        return bool(self._counters)

    def read(self, data: bytes) -> Decoded:
        return Decoded(self._counters.pop(0), {}, data)


@fuzzed(
    "ROS messages",
    looks=st.lists(st.lists(MESSAGES, max_size=3), max_size=12),
    header=st.sampled_from([None, True, False]),
    counters=st.lists(COUNTERS, max_size=36),
    bits=st.sampled_from([None, 8, 64]),
)
def test_any_messages_are_facts(
    looks: list[list[RawMessage]], header: bool | None, counters: list[float | None], bits: int | None
) -> None:
    """Facts that the daemon can read."""
    wanted = WantedData(max_age_s=0.5, order=True, frozen_s=1.0, counter="seq", hz=4.0)
    decoder = Numbers(counters, bits)
    monitor = DataMonitor(wanted, 10.0, lambda *_: decoder, begins_with_header=lambda _: header)
    for number, messages in enumerate(looks):
        monitor.update(number / 4, "my_msgs/msg/Odometry", messages, mixed=number % 2 == 0)
        graph = GraphMessage(1.0, topics={"/t": TopicFact(data=monitor.fact)})
        assert decode(encode(graph)) == graph
