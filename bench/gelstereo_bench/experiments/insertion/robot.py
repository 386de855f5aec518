"""Pose to which a robot moves the part: exact, or with errors of the coordinate transforms and of the motion.

The robot was taught the hole by a grasp over it: the true pose of the part in the sensor was Y, and the
estimate Ŷ. Now the true pose is X and the estimate X̂. The robot moves so that the estimated part would be
where it was during teaching, and brings the part to Y⁻¹ Ŷ X̂⁻¹ X in the hole's frame. An error ε of the
sensor's pose in the hand changes that to Y⁻¹ exp(-ε) Ŷ X̂⁻¹ exp(ε) X. It matters only as far as the robot
rotates the part, as the paper observed (section VI-B).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_exp

__all__ = ["RobotErrors", "over_hole"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RobotErrors:
    """Standard deviations per component."""

    #: Error of the sensor's pose in the hand, drawn once per robot.
    mount_rad: float = 0.0
    mount_mm: float = 0.0
    #: Error of each motion.
    motion_rad: float = 0.0
    motion_mm: float = 0.0

    def times(self, scale: float) -> RobotErrors:
        """All errors multiplied by a factor."""
        return RobotErrors(
            self.mount_rad * scale, self.mount_mm * scale, self.motion_rad * scale, self.motion_mm * scale
        )

    def draw(self, robot: int, trial: int) -> tuple[Array, Array]:
        """Draw the errors of mount and motion, twists (ω, v), for a robot and one of its trials."""
        mount = np.random.default_rng([robot, 83]).normal(size=6)
        motion = np.random.default_rng([robot, trial, 89]).normal(size=6)
        return (
            mount * np.repeat([self.mount_rad, self.mount_mm], 3),
            motion * np.repeat([self.motion_rad, self.motion_mm], 3),
        )


def over_hole(
    t_sensor_object: Array,
    found: Array,
    taught: tuple[Array, Array],
    mount: Array | None = None,
    motion: Array | None = None,
    about_mm: Array | None = None,
) -> Array:
    """Pose of the part in the hole's frame after alignment by the robot; ideally the identity.

    Parameters
    ----------
    t_sensor_object, found
        True and found pose in the sensor, (4, 4).
    taught
        True and found pose of the grasp over the hole.
    mount, motion
        Errors, twists (ω, v): of the sensor's pose in the hand, in the sensor's frame about `about_mm`; and
        of the motion, in the hole's frame.
    about_mm
        Point of the sensor's frame about which `mount` rotates. Default: the frame's origin.
    """
    slip = np.eye(4)
    if mount is not None:
        about = np.eye(4)
        about[:3, 3] = 0.0 if about_mm is None else about_mm
        slip = about @ np.asarray(se3_exp(mount)) @ np.linalg.inv(about)
    truth, learned = taught
    goal = np.linalg.inv(truth) @ np.linalg.inv(slip) @ learned
    placed = goal @ np.linalg.inv(found) @ slip @ t_sensor_object
    if motion is not None:
        placed = np.asarray(se3_exp(motion)) @ placed
    return np.asarray(placed)
