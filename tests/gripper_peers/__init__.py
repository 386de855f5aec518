"""Gripper peers: protocol servers by other authors, on lines with and without faults."""
