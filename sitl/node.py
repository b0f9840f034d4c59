"""One node of the demo application: real rclpy, publishes and subscribes std_msgs/String.

    python -m sitl.node --name node_1 --namespace /agent_1 --publish topic_1:10 --subscribe topic_3

SIGUSR1 silences its topics and lets them speak again, SIGUSR2 halves their rate and gives it back: the process
and its place in the graph stay as they are.

It has a beacon, unless `--no-beacon` says otherwise. Imports rclpy, std_msgs, the one file phm/beacon.py and the standard
library alone, so that it runs in any ROS image.
"""

from __future__ import annotations

import argparse
import signal
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from phm.beacon import Beacon

LOOK_S = 0.5
"""How often an idle node looks whether it has been told to end."""


class Voice:
    """What the node does with its topics' ticks; changed by signals."""

    def __init__(self) -> None:
        self.silent = self.halved = False

    def listen(self) -> None:
        """Take the two signals. rclpy's own handlers are for SIGINT and SIGTERM alone."""
        signal.signal(signal.SIGUSR1, lambda *_: setattr(self, "silent", not self.silent))
        signal.signal(signal.SIGUSR2, lambda *_: setattr(self, "halved", not self.halved))

    def speaks(self, tick: int) -> bool:
        return not self.silent and not (self.halved and tick % 2)


def main(argv: list[str] | None = None) -> int:
    """Run until SIGTERM or SIGINT, then leave the graph properly."""
    options = _options(argv)
    # rclpy's own handlers end `spin` on SIGTERM, so that the node says good-bye to the graph.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.ALL)
    node = rclpy.create_node(options.name, namespace=options.namespace)
    if options.beacon:
        Beacon(node)
    voice = Voice()
    voice.listen()
    for topic, rate_hz in options.publish:
        publisher = node.create_publisher(String, topic, 10)
        node.create_timer(1.0 / rate_hz, _publishing(publisher, options.name, voice))
    for topic in options.subscribe:
        node.create_subscription(String, topic, _ignore, 10)
    try:
        # Not `spin`: a SIGTERM that comes just before it waits is lost on a node without timers, which then never ends.
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=LOOK_S)
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
    parser.add_argument("--no-beacon", action="store_false", dest="beacon")
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


def _publishing(publisher: Any, name: str, voice: Voice) -> Callable[[], None]:
    count = 0

    def publish() -> None:
        nonlocal count
        count += 1
        if voice.speaks(count):
            publisher.publish(String(data=f"{name} {count}"))

    return publish


def _ignore(_: Any) -> None:
    pass


if __name__ == "__main__":
    raise SystemExit(main())
