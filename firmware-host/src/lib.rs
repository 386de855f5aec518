//! gelstereo on the robot's computer.
