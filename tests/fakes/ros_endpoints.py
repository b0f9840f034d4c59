"""A real node with endpoints of any quality of service, until it is terminated.

    python tests/fakes/ros_endpoints.py NODE SIDE:TOPIC[:POLICY=VALUE,...] ...

SIDE is `pub` or `sub`, TOPIC of std_msgs/String. Policies: reliability, durability, liveliness (in words) and
deadline, lease (in seconds).
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String


def main(name: str, *ends: str) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node(name, namespace="/agent_1")
    for end in ends:
        side, topic, *policies = end.split(":")
        qos = profile(dict(policy.split("=") for policy in ",".join(policies).split(",") if policy))
        if side == "pub":
            node.create_publisher(String, topic, qos)
        else:
            node.create_subscription(String, topic, print, qos)
    rclpy.spin(node)


def profile(policies: dict[str, str]) -> QoSProfile:
    qos = QoSProfile(depth=1)
    kinds = {"reliability": ReliabilityPolicy, "durability": DurabilityPolicy, "liveliness": LivelinessPolicy}
    for policy, text in policies.items():
        if policy in kinds:
            setattr(qos, policy, kinds[policy][text.upper()])
        else:
            setattr(qos, {"lease": "liveliness_lease_duration"}.get(policy, policy), Duration(seconds=float(text)))
    return qos


if __name__ == "__main__":
    main(*sys.argv[1:])
