"""A real lifecycle node /agent_1/NAME.

    python tests/fakes/ros_lifecycle.py NAME < transitions

Each line of standard input is a transition: `configure`, `activate`, `deactivate`, or `fail` (a deactivation that fails, and
whose error handling fails too, so that the node is finalized); `block` blocks the executor from then on. While it is active
it publishes on /agent_1/plan ten times a second. Once configured it offers the services /agent_1/plan_path, and
/agent_1/is_ready, which answers whether it is active.
"""

from __future__ import annotations

import os
import select
import sys
import time
from pathlib import Path
from typing import Any

os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).resolve().parents[2] / "config" / "fastdds.xml")

# The middleware reads the profile when it is loaded.
import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String
from std_srvs.srv import Trigger

TURN_S = 0.05


class Planner(LifecycleNode):  # type: ignore[misc]
    fails = False

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        self._plan = self.create_lifecycle_publisher(String, "plan", 10)
        self.create_timer(0.1, lambda: self._plan.publish(String(data="north")))
        self.create_service(ListParameters, "plan_path", lambda request, response: response)
        self.create_service(Trigger, "is_ready", self.is_ready)
        return super().on_configure(state)

    def is_ready(self, request: Any, response: Any) -> Any:
        response.success = self._plan.is_activated
        response.message = "" if response.success else "waits for its activation"
        return response

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.ERROR if self.fails else super().on_deactivate(state)

    def on_error(self, state: Any) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.FAILURE


def main(name: str) -> None:
    rclpy.init(args=[])
    node = Planner(name, namespace="/agent_1")
    while True:
        rclpy.spin_once(node, timeout_sec=TURN_S)
        if not select.select([0], [], [], 0)[0]:
            continue
        for word in os.read(0, 100).decode().split():
            if word == "block":
                time.sleep(3600)
            Planner.fails = word == "fail"
            getattr(node, f"trigger_{'deactivate' if word == 'fail' else word}")()


if __name__ == "__main__":
    main(sys.argv[1])
