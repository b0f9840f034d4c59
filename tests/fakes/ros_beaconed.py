"""Nodes with a beacon that misbehave on request, for tests: a real process with real executors.

    python tests/fakes/ros_beaconed.py NAME... [--executor single|multi] [--hello TOPIC] [--hang callback|own] ...

SIGUSR1 hangs a callback of the first node permanently, asleep (`--hang own`: in its own callback group); SIGUSR2
destroys the first node and creates it again, or, with `--lose`, makes its beacon lose the present subscriptions: it sends
again when there is a new one, as a participant that has dropped another one whose announcements it considers as
acknowledged. `--hello` has the process announce itself, and listen, on a separate
topic: PHM receives it and its neighbours do not.
"""

from __future__ import annotations

import argparse
import signal
import threading
import time
from typing import Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter

from phm import beacon

POLL_S = 0.05


class Nodes:
    """The nodes of this process, pending requests of signals, and a lock that is never released."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self.hang = self.renew = False
        self._never_released = threading.Lock()
        self._never_released.acquire()
        multi = options.executor == "multi"
        self.executor: Any = MultiThreadedExecutor(num_threads=3) if multi else SingleThreadedExecutor()
        self._nodes = [self._make(name) for name in options.names]
        signal.signal(signal.SIGUSR1, lambda *_: setattr(self, "hang", True))
        signal.signal(signal.SIGUSR2, lambda *_: setattr(self, "renew", True))

    def work(self) -> None:
        """Handle requests between two iterations of the executor."""
        if self.renew:
            self.renew = False
            if self._options.lose:
                _lose_subscriptions(self._nodes[0])
                return
            self.executor.remove_node(self._nodes[0])
            self._nodes[0].destroy_node()
            self._nodes[0] = self._make(self._options.names[0])
        if self._options.spin:
            self.executor.spin_once(timeout_sec=POLL_S)
        else:
            time.sleep(POLL_S)

    def _make(self, name: str) -> Any:
        kind = LifecycleNode if self._options.lifecycle else rclpy.create_node
        simulated = [Parameter("use_sim_time", value=True)] if self._options.sim_time else []
        node = kind(name, namespace=self._options.namespace, parameter_overrides=simulated)
        group = MutuallyExclusiveCallbackGroup() if self._options.hang == "own" else None
        beacon.Beacon(node, period_s=self._options.period, watch_executor=self._options.watch)
        node.create_timer(POLL_S, self._perhaps_hang, callback_group=group, clock=_steady())
        self.executor.add_node(node)
        return node

    def _perhaps_hang(self) -> None:
        if self.hang:
            self._never_released.acquire()


def _lose_subscriptions(node: Any) -> None:
    """Let no beacon of this process be sent before there is another subscription."""

    def subscriptions() -> set[bytes]:
        return {bytes(info.endpoint_gid) for info in node.get_subscriptions_info_by_topic(beacon.BEACON)}

    (hub,) = beacon._hubs.values()
    lost, send = subscriptions(), hub._beacon.say
    hub._beacon.say = lambda said: send(said) if subscriptions() - lost else None


def _steady() -> Any:
    return Clock(clock_type=ClockType.STEADY_TIME)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="+")
    parser.add_argument("--namespace", default="/agent_1")
    parser.add_argument("--executor", choices=("single", "multi"), default="single")
    parser.add_argument("--hang", choices=("callback", "own"), default="callback")
    parser.add_argument("--hello", default=beacon.HELLO)
    parser.add_argument("--period", type=float, default=beacon.PERIOD_S)
    parser.add_argument("--lifecycle", action="store_true")
    parser.add_argument("--lose", action="store_true")
    parser.add_argument("--sim-time", action="store_true")
    parser.add_argument("--no-spin", action="store_false", dest="spin")
    parser.add_argument("--no-watch", action="store_false", dest="watch")
    options = parser.parse_args()
    beacon.HELLO = options.hello
    rclpy.init(args=[])
    nodes = Nodes(options)
    while rclpy.ok():
        nodes.work()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
