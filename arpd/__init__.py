"""Keeps a ROS 2 robot's wireless traffic inside what the link can carry, live."""
