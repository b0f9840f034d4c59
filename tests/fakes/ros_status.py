"""A real node that sends or receives diagnostics, in the format of diagnostic_updater.

    python tests/fakes/ros_status.py say NAME < lines of JSON
    python tests/fakes/ros_status.py receive NAME [TOPIC] > lines of JSON

`say`: each line is a list of `[name, level, message, hardware_id, {key: value}]` and is published ten times a second, replacing
the previous line, as one array, reliable and with a queue of one. `receive` prints each array it gets: `[frame_id, [...as above]]`.
TOPIC: /diagnostics by default.
"""

from __future__ import annotations

import json
import select
import sys
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

PERIOD_S = 0.1


def main(role: str, name: str, topic: str = "/diagnostics") -> None:
    rclpy.init(args=[])
    node = rclpy.create_node(name, namespace="/agent_1")
    say(node) if role == "say" else receive(node, topic)


def say(node: Node) -> None:
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
    statuses: list[Any] = []
    while True:
        if select.select([0], [], [], PERIOD_S)[0]:
            statuses = json.loads(sys.stdin.readline())
        array = DiagnosticArray()
        array.header.stamp = node.get_clock().now().to_msg()
        array.status = [_status(*fields) for fields in statuses]
        publisher.publish(array)


def _status(name: str, level: int, message: str, hardware_id: str, values: dict[str, str]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=bytes([level]), message=message, hardware_id=hardware_id, values=pairs)


def receive(node: Node, topic: str) -> None:
    def take(array: DiagnosticArray) -> None:
        statuses = [
            [s.name, s.level[0], s.message, s.hardware_id, {pair.key: pair.value for pair in s.values}]
            for s in array.status
        ]
        sys.stdout.write(json.dumps([array.header.frame_id, statuses]) + "\n")
        sys.stdout.flush()

    node.create_subscription(DiagnosticArray, topic, take, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
