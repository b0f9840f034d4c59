"""Copies received messages on the beacons' topic, ten times a second; `python tests/fakes/ros_beacon_replay.py NAME HOW`.

HOW: `copy` sends the newest beacon of NAME again, with its identity, as one with a hung executor. `crowd` sends two messages of
the maximum size of a beacon, each of 50 nodes that receive 50 others, all with the longest names allowed.
"""

from __future__ import annotations

import json
import sys
import time
from itertools import count
from typing import Any

import rclpy
from rcl_interfaces.msg import Log
from rclpy.qos import qos_profile_sensor_data

from phm.beacon import BEACON, BEACON_FORMAT, MAX_NEIGHBOURS, MAX_NODES, MAX_TEXT


def crowd(turn: int) -> list[str]:
    """Messages of nodes that do not exist, other ones each time."""
    node = {"birth": "b", "beats": turn, "turns": 1, "late_s": 0.0}
    view = {"alive": True, "age_s": 0.1, "late_s": 0.0}
    texts = []
    for number in range(2):
        nodes = {f"/{'n' * 200}_{turn % 4}_{number}_{index}": node for index in range(MAX_NODES)}
        views = {f"/{'v' * 245}_{index}": view for index in range(MAX_NEIGHBOURS)}
        texts.append(json.dumps({"witness": f"crowd{number}", "period_s": 0.2, "nodes": nodes, "views": views}))
    assert all(len(text) <= MAX_TEXT for text in texts)
    return texts


def copied(received: Any, name: str) -> list[str]:
    """A copy of the beacon, very late."""
    said = json.loads(received.msg)
    if name not in said["nodes"] or said["nodes"][name]["late_s"] == 99.0:
        return []
    said["nodes"][name]["late_s"] = 99.0
    return [json.dumps(said)]


def main(name: str, how: str) -> int:
    rclpy.init(args=[])
    node = rclpy.create_node("copycat", namespace="/elsewhere")
    publisher = node.create_publisher(Log, BEACON, 10)
    texts: list[str] = []

    def receive(message: Any) -> None:
        texts[:] = copied(message, name) or texts

    if how == "copy":
        node.create_subscription(Log, BEACON, receive, qos_profile_sensor_data)
    for turn in count():
        rclpy.spin_once(node, timeout_sec=0.05)
        for text in crowd(turn) if how == "crowd" else texts:
            publisher.publish(Log(name=BEACON_FORMAT, msg=text))
        time.sleep(0.05)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
