"""Examines a few messages of a topic: stamp, order, repeated content, counter, ranges. Runs only in the ROS child."""
