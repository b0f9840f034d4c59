"""One node of the demo application: real rclpy, publishes and subscribes std_msgs/String.

    python -m sitl.node --name node_1 --namespace /agent_1 --publish topic_1:10 --subscribe topic_3

Imports rclpy, std_msgs and the standard library alone, so that it runs in any ROS image.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String


def main(argv: list[str] | None = None) -> int:
    """Run until SIGTERM or SIGINT, then leave the graph properly."""
    options = _options(argv)
    # rclpy's own handlers end `spin` on SIGTERM, so that the node says good-bye to the graph.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.ALL)
    node = rclpy.create_node(options.name, namespace=options.namespace)
    for topic, rate_hz in options.publish:
        publisher = node.create_publisher(String, topic, 10)
        node.create_timer(1.0 / rate_hz, _publishing(publisher, options.name))
    for topic in options.subscribe:
        node.create_subscription(String, topic, _ignore, 10)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _options(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m sitl.node", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--name", required=True)
    parser.add_argument("--namespace", default="/")
    parser.add_argument("--publish", action="append", default=[], type=topic_rate, metavar="TOPIC:HZ")
    parser.add_argument("--subscribe", action="append", default=[], metavar="TOPIC")
    return parser.parse_args(argv)


def topic_rate(text: str) -> tuple[str, float]:
    """`topic_1:10` -> ("topic_1", 10.0). Raises argparse's error for a rate that is not above zero."""
    topic, _, rate = text.rpartition(":")
    try:
        rate_hz = float(rate)
    except ValueError:
        rate_hz = 0.0
    if not topic or not rate_hz > 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not TOPIC:HZ with a rate above zero, e.g. topic_1:10")
    return topic, rate_hz


def _publishing(publisher: Any, name: str) -> Callable[[], None]:
    count = 0

    def publish() -> None:
        nonlocal count
        count += 1
        publisher.publish(String(data=f"{name} {count}"))

    return publish


def _ignore(_: Any) -> None:
    pass


if __name__ == "__main__":
    raise SystemExit(main())
