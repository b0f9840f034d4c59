"""One node of the demo application: real rclpy, publishes and subscribes std_msgs/String.

    python -m sitl.application.node --name node_1 --namespace /agent_1 --publish topic_1:10 --subscribe topic_3

Signals change what it does, and a second one of the same kind changes it back; the process stays the same. SIGUSR1 silences its
topics, SIGUSR2 halves their rate, SIGHUP makes it give up its subscriptions, and SIGRTMIN+1 offer its topics as best
effort, which a reliable subscription does not take; `sitl.application.behaviour` has the others. What it receives is in a file, see
`sitl.application.received`.

It has a beacon, unless `--no-beacon` says otherwise. Imports rclpy, std_msgs, the one file phm/beacon.py, its own package and the
standard library alone, so that it runs in any ROS image.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from phm.beacon import Beacon
from sitl.application.behaviour import Behaviour
from sitl.application.reading import Reading
from sitl.application.received import Record

DEPTH = 10
OPTIONS_VARIABLE = "SITL_NODE"
"""Environment variable with the options, a list in JSON, for a node that is started without any."""
POLL_S = 0.5
"""How often an idle node checks for a request to end."""


class Endpoints:
    """The node's publishers and subscriptions, recreated when its behaviour changes."""

    def __init__(
        self,
        node: Node,
        publish: Sequence[tuple[str, float]],
        subscribe: Sequence[str],
        behaviour: Behaviour,
        record: Record,
    ) -> None:
        self._node, self._behaviour, self._record = node, behaviour, record
        self._publish, self._subscribe = tuple(publish), tuple(subscribe)
        self._unsubscribed = self._careless = False
        self._subscriptions: list[Any] = []
        self._publishers: dict[str, Any] = {}
        self._listen()
        self._offer()
        for topic, rate_hz in self._publish:
            node.create_timer(1.0 / rate_hz, self._publishing(topic))

    def follow(self) -> None:
        """Not in the signal's handler, which may come in the middle of the executor's work."""
        if self._unsubscribed != self._behaviour.unsubscribed:
            self._unsubscribed = self._behaviour.unsubscribed
            self._listen()
        if self._careless != self._behaviour.careless:
            self._careless = self._behaviour.careless
            self._offer()

    def _listen(self) -> None:
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        wanted = () if self._unsubscribed else self._subscribe
        self._subscriptions = [
            self._node.create_subscription(String, topic, self._record.listener(topic), DEPTH) for topic in wanted
        ]

    def _offer(self) -> None:
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        how = ReliabilityPolicy.BEST_EFFORT if self._careless else ReliabilityPolicy.RELIABLE
        profile = QoSProfile(depth=DEPTH, reliability=how)
        self._publishers = {topic: self._node.create_publisher(String, topic, profile) for topic, _ in self._publish}

    def _publishing(self, topic: str) -> Callable[[], None]:
        count = 0

        def publish() -> None:
            nonlocal count
            count += 1
            self._behaviour.fail()
            if self._behaviour.speaks(count):
                self._publishers[topic].publish(String(data=f"{self._node.get_name()} {count}"))

        return publish


def main(argv: list[str] | None = None) -> int:
    """Run until SIGTERM or SIGINT, then leave the graph properly."""
    options = _options(argv)
    # rclpy's own handlers end `spin` on SIGTERM, so that the node says good-bye to the graph.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.ALL)
    try:
        _work(options)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:  # rclpy's own kinds: a SIGTERM that comes while node and executor are made leaves them no context
        if rclpy.ok():
            raise
    rclpy.try_shutdown()
    return 0


def _work(options: argparse.Namespace) -> None:
    """Until rclpy shuts down."""
    node = rclpy.create_node(options.name, namespace=options.namespace)
    try:
        if options.beacon:
            Beacon(node)
        behaviour = Behaviour()
        behaviour.listen()
        record = Record(options.name)
        ends = Endpoints(node, options.publish, options.subscribe, behaviour, record)
        reading = Reading(node, behaviour, record)
        # Not `spin`: a SIGTERM that comes just before it waits is lost on a node without timers, which then never ends.
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # In one write: others write to the same pipe, and `print` would put its newline after theirs.
        os.write(sys.stdout.fileno(), f"node: {options.name} is up\n".encode())
        while rclpy.ok():
            executor.spin_once(timeout_sec=POLL_S)
            ends.follow()
            if record.due():
                reading.follow()
    finally:
        node.destroy_node()


def _options(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m sitl.application.node", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("--name", required=True)
    parser.add_argument("--namespace", default="/")
    parser.add_argument("--publish", action="append", default=[], type=topic_rate, metavar="TOPIC:HZ")
    parser.add_argument("--subscribe", action="append", default=[], metavar="TOPIC")
    parser.add_argument("--no-beacon", action="store_false", dest="beacon")
    if argv is None and len(sys.argv) == 1 and OPTIONS_VARIABLE in os.environ:
        argv = json.loads(os.environ[OPTIONS_VARIABLE])
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


if __name__ == "__main__":
    raise SystemExit(main())
