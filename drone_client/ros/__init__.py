"""Accepted poses for ROS 2, over Zenoh and without any part of ROS (docs/ros.md)."""
