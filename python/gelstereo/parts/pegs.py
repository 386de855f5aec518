"""The five objects that the paper grasps and inserts (Fig. 10): pegs (a) to (d) and a USB plug.

The paper gives no dimensions; those here are estimated from its pictures. Pegs (a), (b) and (d) follow the
IROS robotic grasping and manipulation competition, whose pegs are round and prismatic. Peg (c) has an
irregular cap. All stand on the plane z = 0 with their axis along z; the inserted end points towards +z.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo.parts.sections import loft, polar, rectangle, regular

if TYPE_CHECKING:
    import trimesh

__all__ = ["peg_hexagonal", "peg_irregular", "peg_round", "peg_square", "usb_plug"]

Array = npt.NDArray[np.float64]

_CHAMFER_MM = 0.5


def peg_round(diameter_mm: float = 8.0, length_mm: float = 40.0) -> trimesh.Trimesh:
    """Peg (a): round, its tip chamfered."""
    radius_mm = 0.5 * diameter_mm
    body, tip = polar(radius_mm, 128), polar(radius_mm - _CHAMFER_MM, 128)
    return loft([(0.0, body), (length_mm - _CHAMFER_MM, body), (length_mm, tip)])


def peg_square(side_mm: float = 8.0, length_mm: float = 40.0) -> trimesh.Trimesh:
    """Peg (b): square, its tip chamfered."""
    body, tip = rectangle(side_mm, side_mm), rectangle(side_mm - 2 * _CHAMFER_MM, side_mm - 2 * _CHAMFER_MM)
    return loft([(0.0, body), (length_mm - _CHAMFER_MM, body), (length_mm, tip)])


def peg_irregular(diameter_mm: float = 8.0, length_mm: float = 40.0, cap_mm: float = 20.0) -> trimesh.Trimesh:
    """Peg (c): a round shaft under a cap of `cap_mm`, which is grasped. It has no rotational symmetry."""

    def cap(share: float) -> Array:
        def radius(angle: Array) -> Array:
            lobes = 1.3 * np.cos(2 * angle + 0.4) + 0.9 * np.cos(3 * angle - 1.1 + 0.8 * share)
            return 0.5 * diameter_mm + 2.2 + lobes - 1.1 * share

        return polar(radius, 128)

    shaft, tip = polar(0.5 * diameter_mm, 128), polar(0.5 * diameter_mm - _CHAMFER_MM, 128)
    shares = np.linspace(0.0, 1.0, 21)
    return loft(
        [
            *[(cap_mm * float(share), cap(float(share))) for share in shares],
            (cap_mm, shaft),
            (length_mm - _CHAMFER_MM, shaft),
            (length_mm, tip),
        ]
    )


def peg_hexagonal(across_flats_mm: float = 8.0, length_mm: float = 40.0) -> trimesh.Trimesh:
    """Peg (d): hexagonal, its tip chamfered."""
    body, tip = regular(6, across_flats_mm, 6), regular(6, across_flats_mm - 2 * _CHAMFER_MM, 6)
    return loft([(0.0, body), (length_mm - _CHAMFER_MM, body), (length_mm, tip)])


def usb_plug(body_mm: tuple[float, float, float] = (15.0, 7.5, 22.0)) -> trimesh.Trimesh:
    """Peg (e): a USB type A plug, 12.0 x 4.5 mm and 11.75 mm deep (standard dimensions), on a
    moulded body.
    """
    width_mm, thickness_mm, length_mm = body_mm
    shell_mm, wall_mm, depth_mm = (12.0, 4.5), 0.3, 11.75
    points = 32
    body = rectangle(width_mm, thickness_mm, points, corner_mm=1.5)
    narrow = rectangle(width_mm - 1.0, thickness_mm - 1.0, points, corner_mm=1.0)
    shell = rectangle(*shell_mm, points, corner_mm=0.4)
    mouth = rectangle(shell_mm[0] - 2 * wall_mm, shell_mm[1] - 2 * wall_mm, points, corner_mm=0.2)
    tip = length_mm + depth_mm
    # The last three rings lead into the shell; the carrier of the contacts fills it from 9 mm on.
    return loft(
        [
            (0.0, narrow),
            (0.5, body),
            (length_mm - 0.5, body),
            (length_mm, narrow),
            (length_mm, shell),
            (tip, shell),
            (tip, mouth),
            (tip - 9.0, mouth),
        ]
    )
