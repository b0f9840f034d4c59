"""Records when samples of real publisher processes were published and received; the results are beside this file.

python -m tests.ros.traces.record SECONDS SHAPE... # records all shapes at the same time, over real ROS on loopback

Each shape is published by a separate process with rclpy, and received by the middleware of this one. A trace is JSON:
`shape`, `hz`, `recorded` (date), `machine`, `gaps` (tenths of a millisecond from one publication to the next, by the
publisher's clock), `delays` (tenths of a millisecond from publication to reception), and `lost` (positions in the list
before which samples were lost in transit, with their number).
"""

from __future__ import annotations

import itertools
import json
import os
import platform
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
LONGEST_S = 2.7
"""No shape pauses for longer on purpose: beyond 3 s a 1 Hz topic is silent by its configuration."""


def steady(_: random.Random) -> Iterator[float]:
    """1 Hz, by a timer."""
    while True:
        yield 1.0


def lognormal(rnd: random.Random) -> Iterator[float]:
    """1 Hz on average; every period is drawn, with a long tail."""
    while True:
        yield min(LONGEST_S, rnd.lognormvariate(-0.045, 0.3))


def bursty(rnd: random.Random) -> Iterator[float]:
    """Three samples in a burst, then a pause, as from a planner or over radio: 1.2 Hz on average."""
    while True:
        yield from (0.05, 0.05, rnd.uniform(2.3, LONGEST_S))


def stalling(rnd: random.Random) -> Iterator[float]:
    """1 Hz by a timer, but one period in a hundred is more than twice as long, as in a process that swaps."""
    while True:
        yield rnd.uniform(2.0, LONGEST_S) if rnd.random() < 0.01 else 1.0


def fast(_: random.Random) -> Iterator[float]:
    """10 Hz; recorded while other processes use all cores."""
    while True:
        yield 0.1


SHAPES = {shape.__name__: shape for shape in (steady, lognormal, bursty, stalling, fast)}


def publish(name: str) -> None:
    """The publisher process: publishes until it is ended."""
    import rclpy
    from std_msgs.msg import String

    rclpy.init(args=[])
    node = rclpy.create_node(f"trace_{name}")
    publisher = node.create_publisher(String, f"/trace/{name}", 10)
    next_s = time.monotonic()
    for gap_s in SHAPES[name](random.Random(name)):
        # A late process stays late by the same time, like a timer that does not catch up.
        next_s = max(next_s + gap_s, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))
        publisher.publish(String(data=name))


def record(seconds: float, names: list[str]) -> None:
    """Start the publishers, subscribe, and write one file for each."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import String

    rclpy.init(args=[])
    node: Any = rclpy.create_node("_phm_trace", start_parameter_services=False, enable_rosout=False)
    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    readers = {name: node.create_subscription(String, f"/trace/{name}", print, qos, raw=True) for name in names}
    taken: dict[str, list[tuple[int, int, int]]] = {name: [] for name in names}
    processes = [subprocess.Popen([sys.executable, "-m", "tests.ros.traces.record", "publish", name]) for name in names]
    try:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            time.sleep(0.5)
            for name, reader in readers.items():
                _take(reader, taken[name])
            sys.stderr.write(f"\r{left_s:5.0f} s left")
    finally:
        for process in processes:
            process.kill()
            process.wait()
    for name, samples in taken.items():
        (HERE / f"{name}.json").write_text(json.dumps(trace(name, samples), separators=(",", ":")) + "\n")


def _take(reader: Any, into: list[tuple[int, int, int]]) -> None:
    with reader.handle:
        while (found := reader.handle.take_message(reader.msg_type, True)) is not None:
            info = found[1]
            into.append((info["publication_sequence_number"], info["source_timestamp"], info["received_timestamp"]))


def trace(name: str, samples: list[tuple[int, int, int]]) -> dict[str, Any]:
    """The samples (number, published, received; nanoseconds) as they are written."""
    pairs = list(itertools.pairwise(samples))
    gaps = [round((new[1] - old[1]) / 1e5) for old, new in pairs]
    mean_s = sum(gaps) / 1e4 / (samples[-1][0] - samples[0][0])
    return {
        "shape": name,
        "about": SHAPES[name].__doc__,
        "hz": round(1 / mean_s, 4),
        "recorded": time.strftime("%Y-%m-%d", time.gmtime()),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Linux {platform.release()}",
        "lost": {str(at): new[0] - old[0] - 1 for at, (old, new) in enumerate(pairs) if new[0] != old[0] + 1},
        "delays": [round((received - published) / 1e5) for _, published, received in samples],
        "gaps": gaps,
    }


if __name__ == "__main__":
    if sys.argv[1] == "publish":
        publish(sys.argv[2])
    else:
        record(float(sys.argv[1]), sys.argv[2:])
