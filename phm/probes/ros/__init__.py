"""The ROS probe: a supervised child process that looks at the graph (`process` is the daemon's side)."""
