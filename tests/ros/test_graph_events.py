"""The graph events of the installed middleware: seen without polling, and released immediately."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.fakes.ros_bench import ROOT, Bench

SCRIPT = """
import select
import rclpy
from phm.probes.ros import graph_events

LIMIT_S = 60.0
context = rclpy.Context()
rclpy.init(context=context)
node = rclpy.create_node("_phm_watching", context=context)
graph_events.FAREWELL_S = LIMIT_S
events = graph_events.GraphEvents(node, context)
assert events.fd is not None, "no events with this distribution"

def seen():
    return bool(select.select([events.fd], [], [], LIMIT_S)[0])

other = rclpy.create_node("other", context=context)
print("came", seen())
while select.select([events.fd], [], [], 1.0)[0]:  # all that its coming has changed
    events.take()
other.destroy_node()
print("went", seen())
events.close()
print("ended", not events._thread.is_alive(), events.fd)
node.destroy_node()
rclpy.shutdown(context=context)
"""


def test_a_new_node_and_a_departed_node_are_events(bench: Bench) -> None:
    """And the thread that waits for them ends on request, with its descriptor."""
    environ = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "ROS_DOMAIN_ID": str(bench.domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, timeout=180, check=False, env=environ)
    assert done.stdout.split(b"\n")[:3] == [b"came True", b"went True", b"ended True None"], done.stderr.decode()[-800:]
