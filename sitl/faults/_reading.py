"""Faults of the data on the topic `reading` of the demo application, which it has for these faults alone."""

from __future__ import annotations

from collections.abc import Mapping

from sitl.application.reading import MARKER, RATE_HZ, TOPIC
from sitl.faults._application import data_is_good
from sitl.faults._node_signal import NodeSignal
from sitl.faults.base import Agent

PUBLISHER, SUBSCRIBER = "node_1", "node_2"
LAST_TOPIC = '\n      subscribers: ["/${PHM_AGENT:-agent_1}/node_1"]'


class ReadingFault(NodeSignal):
    """Has node_1 publish wrong data at the right rate. PHM must be configured to look at it."""

    layer = "ros"
    unit = "data/{agent}/reading"
    needs = frozenset({"configuration"})
    prepared = "a topic `reading` from node_1 to node_2"

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        topic = (
            f"\n    - name: /{agent.name}/{TOPIC}\n      type: geometry_msgs/msg/PointStamped\n      rate: {RATE_HZ:g}Hz"
            f"\n      publishers: [/{agent.name}/{PUBLISHER}]\n      container: ros_app"
            "\n      data: {max_age: 2s, order: true, frozen: 2s, counter: point.x, ranges: {point.y: [-1, 1]}}"
        )
        return {LAST_TOPIC: f"{LAST_TOPIC}{topic}"}

    def prepare(self, agent: Agent) -> None:
        agent.write_in_app(str(MARKER), f"{PUBLISHER} {SUBSCRIBER}\n".encode())

    def dismantle(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", str(MARKER))

    def restored(self, agent: Agent) -> bool | None:
        return data_is_good(agent)
