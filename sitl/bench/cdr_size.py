"""Bytes of the DiagnosticArray that PHM's ROS child makes of the statuses on standard input; nothing where ROS is not installed.

A separate process, because only the ROS child imports rclpy. No participant is made, so nothing is sent.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from phm.facts.ros import DiagnosticFact
from phm.probes.ros.diagnostics import DiagnosticsListener
from phm.probes.ros.protocol import Publish


class _Node:
    """Replaces the node: its publisher measures."""

    def create_publisher(self, *_: object) -> _Node:
        return self

    def publish(self, array: Any) -> None:
        from rclpy.serialization import serialize_message

        print(len(serialize_message(array)))


def main() -> int:
    statuses = {name: DiagnosticFact(**fact) for name, fact in json.load(sys.stdin).items()}
    DiagnosticsListener(_Node(), ()).publish(Publish(time.time(), statuses))
    return 0


if __name__ == "__main__":
    sys.exit(main())
