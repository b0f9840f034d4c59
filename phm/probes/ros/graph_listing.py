"""Lists the nodes of the ROS graph once, for `phm init`: a program that prints one line of JSON and ends.

    ROS_DOMAIN_ID=7 python -m phm.probes.ros.graph_listing 4

Started as a separate process, since the middleware may hang or crash. Exit code 3: rclpy cannot be imported.
"""

from __future__ import annotations

import json
import os
import sys
import time

from phm.probes.ros import fastdds_profile

EXIT_MISSING = 3
MAX_NODES = 300


def main(seconds: float) -> int:
    """Wait for discovery, then print `{"nodes": [...]}`: full names, without hidden nodes."""
    fastdds_profile.adapt(os.environ)
    try:
        import rclpy
    except ImportError:
        return EXIT_MISSING
    rclpy.init()
    node = rclpy.create_node(f"_phm_init_{os.getpid()}", start_parameter_services=False, enable_rosout=False)
    time.sleep(seconds)
    names = {f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()}
    shown = sorted(name for name in names if "/_" not in name)
    sys.stdout.write(json.dumps({"nodes": shown[:MAX_NODES]}) + "\n")
    sys.stdout.flush()
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(float(sys.argv[1])))
