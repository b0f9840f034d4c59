"""The ROS probe: a supervised child process that observes the graph (`supervisor` is the daemon's side)."""
