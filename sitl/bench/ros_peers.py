"""The other processes of the ROS benchmark: what publishes, and the two usual ways to measure its rates.

    python -m sitl.bench.ros_peers source|callback|hz BOARD TOPICS HZ SIZE

BOARD is a file that holds a number for each topic (see `Board`): what the source has published, what the callbacks
have received, the rate that the method of `ros2 topic hz` finds.
"""

from __future__ import annotations

import math
import mmap
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from std_msgs.msg import String

WINDOW = 10_000
"""Periods that `ros2 topic hz` averages over."""


def topic(number: int) -> str:
    return f"/bench/topic_{number}"


class Board:
    """Numbers in a file that another process reads while they change; one float per topic."""

    def __init__(self, path: Path, size: int, *, make: bool = False) -> None:
        if make:
            path.write_bytes(bytes(8 * size))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 8 * size)
        self.numbers = memoryview(self._map).cast("d")

    def read(self) -> list[float]:
        return list(self.numbers)


def source(board: Board, topics: int, hz: float, size: int) -> None:
    """Publishes all topics at `hz`, spread evenly, until it is ended."""
    node: Any = rclpy.create_node("bench_source")
    publishers = [node.create_publisher(String, topic(number), 10) for number in range(topics)]
    message = String(data="x" * size)
    began_s, sent = time.monotonic(), 0
    while True:
        number = sent % topics
        delay_s = began_s + sent / (hz * topics) - time.monotonic()
        if delay_s > 0:
            time.sleep(delay_s)
        publishers[number].publish(message)
        board.numbers[number] += 1
        sent += 1


def callback(board: Board, topics: int, _hz: float, _size: int) -> None:
    """A raw subscription of depth 10 for each topic, counted in a callback by an executor."""
    node: Any = rclpy.create_node("bench_callback")
    for number in range(topics):
        node.create_subscription(String, topic(number), _counting(board, number), QoSProfile(depth=10), raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()


def _counting(board: Board, number: int) -> Callable[[bytes], None]:
    def count(_: bytes) -> None:
        board.numbers[number] += 1

    return count


def hz(board: Board, topics: int, _hz: float, _size: int) -> None:
    """As `ros2 topic hz` does it: every period is kept, one message a spin, and averages once a second."""
    node: Any = rclpy.create_node("bench_hz")
    clock = node.get_clock()
    last = [0] * topics
    periods: list[list[int]] = [[] for _ in range(topics)]

    def keep(number: int) -> Callable[[bytes], None]:
        def receive(_: bytes) -> None:
            now = clock.now().nanoseconds
            if last[number]:
                periods[number].append(now - last[number])
                if len(periods[number]) > WINDOW:
                    periods[number].pop(0)
            last[number] = now

        return receive

    for number in range(topics):
        node.create_subscription(String, topic(number), keep(number), qos_profile_sensor_data, raw=True)
    reported_s = time.monotonic()
    while rclpy.ok():
        rclpy.spin_once(node)
        if time.monotonic() - reported_s >= 1.0:
            reported_s = time.monotonic()
            for number, kept in enumerate(periods):
                board.numbers[number] = _average(kept)


def _average(periods: Sequence[int]) -> float:
    """Hertz; the standard deviation is computed because `ros2 topic hz` does, and prints it."""
    if not periods:
        return 0.0
    mean = sum(periods) / len(periods)
    math.sqrt(sum((period - mean) ** 2 for period in periods) / len(periods))
    return 1e9 / mean


def main(role: str, path: str, topics: str, rate: str, size: str) -> None:
    rclpy.init(args=[])
    board = Board(Path(path), int(topics))
    {"source": source, "callback": callback, "hz": hz}[role](board, int(topics), float(rate), int(size))


if __name__ == "__main__":
    main(*sys.argv[1:])
