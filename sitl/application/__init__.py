"""The demonstration's application: ROS 2 nodes and their graph."""
