"""Simulated autopilots, and the demonstration `phm demo` that needs no vehicle, no Docker and no ROS."""
