"""The whole task: a world in one process; camera, gripper and robot in others between it and the host."""
