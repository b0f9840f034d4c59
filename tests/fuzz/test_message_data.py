"""The messages of a topic whose data are examined: any participant of the domain can publish there."""

from __future__ import annotations

from hypothesis import strategies as st

from phm.facts.ros import TopicFact
from phm.probes.ros.data.data_monitor import DataMonitor
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
    st.none() | st.integers(0, 2**64 - 2),
)


@fuzzed(
    "ROS messages",
    looks=st.lists(st.lists(MESSAGES, max_size=3), max_size=12),
    header=st.sampled_from([None, True, False]),
)
def test_any_messages_are_facts(looks: list[list[RawMessage]], header: bool | None) -> None:
    """Facts that the daemon can read."""
    wanted = WantedData(max_age_s=0.5, order=True, frozen_s=1.0, hz=4.0)
    monitor = DataMonitor(wanted, 10.0, begins_with_header=lambda _: header)
    for number, messages in enumerate(looks):
        monitor.look(number / 4, "my_msgs/msg/Odometry", messages, mixed=number % 2 == 0)
        graph = GraphMessage(1.0, topics={"/t": TopicFact(data=monitor.fact)})
        assert decode(encode(graph)) == graph
