"""Rotations, rigid motions, fits and fusion, nearest neighbours and shapes from the core, for checks and
scripts.

Quaternions are (x, y, z, w). Twists are (ωx ωy ωz vx vy vz), radians then millimetres.
"""

from gelstereo._native import (
    fuse_plane,
    fuse_poses,
    nearest,
    rigid_fit,
    se3_exp,
    se3_log,
    shape_mesh,
    so3_exp,
    so3_from_matrix,
    so3_left_jacobian,
    so3_left_jacobian_inverse,
    so3_log,
)

__all__ = [
    "fuse_plane",
    "fuse_poses",
    "nearest",
    "rigid_fit",
    "se3_exp",
    "se3_log",
    "shape_mesh",
    "so3_exp",
    "so3_from_matrix",
    "so3_left_jacobian",
    "so3_left_jacobian_inverse",
    "so3_log",
]
