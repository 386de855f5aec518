"""Grasps of parts: possible poses in the gripper, and initial guesses for registration.

The part lies across the gel with its tip down, towards the sensor frame's +y, between two parallel fingers.
Pitch is its rotation in the gel's plane from the nominal direction, roll its tilt out of that plane. Both
names are the paper's (Fig. 15, Rx and Ry of the sensor).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo import parts
from gelstereo.geometry import se3_exp
from gelstereo_bench.experiments.insertion.hole import Hole, InsertedEnd

if TYPE_CHECKING:
    import trimesh

__all__ = ["GRASPED", "Fit", "GraspRanges", "Grasped", "Hold", "fit_of", "guesses", "lie", "reaching"]

Array = npt.NDArray[np.float64]

#: Half the side of the gel's usable area, mm.
_GEL_HALF_MM = 10.0
#: Minimum ratio of a patch's spread along and across its longer axis.
_LONGER = 1.5
#: Pitches of guesses that do not depend on the patch's outline.
_PITCHES_RAD = (-0.5, 0.0, 0.5)


@dataclass(frozen=True)
class Grasped:
    """A part that is grasped and inserted."""

    name: str
    #: As in the paper, (a) to (e).
    letter: str
    make: Callable[[], trimesh.Trimesh]
    #: Range of the distance from the tip to where the part is held, mm.
    held_mm: tuple[float, float]
    #: Spin angles at which parallel fingers hold the part, rad, and the tolerance about them.
    faces_rad: tuple[float, ...]
    spin_rad: float
    #: Insertion depth, and width of the hole minus width of the part, mm.
    depth_mm: float
    clearance_mm: float
    #: Rotations of the hand about the axis of the standing part, rad, after which the fingers can hold it
    #: again.
    again_rad: tuple[float, ...]
    #: Number of grasps in the paper (section V-A).
    trials: int = 36


_QUARTER = 0.5 * np.pi
#: A hexagon with a corner on +x lies on a flat after a rotation by 30 degrees.
_FLAT = np.pi / 6.0
#: Closing fingers align a face with themselves, up to this error.
_SEATED = 0.05


def _turns(first_rad: float, count: int) -> tuple[float, ...]:
    return tuple(first_rad + 2.0 * np.pi * k / count for k in range(count))


#: The irregular cap rests on two lobes, where its height over a plane has a minimum; on one lobe it would
#: roll.
_ON_LOBES = 2.4


#: Rotations of the hand about a part's axis between grasps: any angle, to the next face, or to the other
#: side.
_ANY_WAY, _NEXT_SIDES, _SIXTHS, _EITHER_SIDE = (
    (0.0, _QUARTER),
    (0.0, _QUARTER),
    _turns(0.0, 6)[:3],
    (0.0, np.pi),
)

#: The paper's pegs; the paper's clearances are below 0.3 mm.
GRASPED = {
    part.letter: part
    for part in (
        Grasped("peg_round", "a", parts.peg_round, (22.0, 28.0), (0.0,), np.pi, 10.0, 0.25, _ANY_WAY),
        Grasped(
            "peg_square",
            "b",
            parts.peg_square,
            (22.0, 28.0),
            _turns(0.0, 4),
            _SEATED,
            10.0,
            0.25,
            _NEXT_SIDES,
        ),
        Grasped(
            "peg_irregular",
            "c",
            parts.peg_irregular,
            (28.0, 32.0),
            (_ON_LOBES,),
            _SEATED,
            10.0,
            0.28,
            _EITHER_SIDE,
        ),
        Grasped(
            "peg_hexagonal",
            "d",
            parts.peg_hexagonal,
            (22.0, 28.0),
            _turns(_FLAT, 6),
            _SEATED,
            10.0,
            0.25,
            _SIXTHS,
        ),
        # The plug fits the socket with only one of its two wide sides.
        Grasped(
            "usb_plug",
            "e",
            parts.usb_plug,
            (21.0, 24.5),
            (_QUARTER,),
            _SEATED,
            8.0,
            0.28,
            _EITHER_SIDE,
            trials=10,
        ),
    )
}


@dataclass(frozen=True)
class Fit:
    """A part and its hole."""

    part: Grasped
    mesh: trimesh.Trimesh
    end: InsertedEnd
    hole: Hole

    def room_mm(self, t_hole_object: Array) -> float:
        """Minimum clearance of the inserted part to the walls, mm; below 0 it does not go in."""
        return self.hole.room_mm(self.end, t_hole_object)


def fit_of(letter: str) -> Fit:
    """Create the part with a letter and its hole."""
    part = GRASPED[letter]
    mesh = part.make()
    end = InsertedEnd.of(mesh)
    return Fit(part, mesh, end, Hole.around(end, part.depth_mm, part.clearance_mm))


@dataclass(frozen=True)
class GraspRanges:
    """Ranges of a part's pose; all values are uniformly distributed."""

    pitch_rad: float = 0.8
    roll_rad: float = 0.05
    #: Offset across its axis from the middle of the gel.
    shift_mm: float = 2.0
    #: Indentation depth.
    press_mm: tuple[float, float] = (0.8, 1.4)


@dataclass(frozen=True)
class Hold:
    """Pose of a part in the hand."""

    pitch_rad: float
    roll_rad: float
    spin_rad: float
    shift_mm: float
    held_mm: float
    press_mm: float

    @classmethod
    def nominal(cls, part: Grasped, ranges: GraspRanges) -> Hold:
        """The taught grasp: in the middle, straight except for a small pitch angle.

        An edge parallel to a row of markers is determined only to one marker pitch; an edge that crosses the
        rows, to a fraction of it.
        """
        return cls(
            0.1, 0.0, part.faces_rad[0], 0.0, float(np.mean(part.held_mm)), float(np.mean(ranges.press_mm))
        )

    @classmethod
    def drawn(cls, part: Grasped, ranges: GraspRanges, random: np.random.Generator) -> Hold:
        """Draw a random hold within the ranges."""
        pitch, roll, spin, shift = random.uniform(-1.0, 1.0, size=4)
        face = part.faces_rad[int(random.integers(len(part.faces_rad)))]
        return cls(
            pitch * ranges.pitch_rad,
            roll * ranges.roll_rad,
            float(face + spin * part.spin_rad),
            shift * ranges.shift_mm,
            float(random.uniform(*part.held_mm)),
            float(random.uniform(*ranges.press_mm)),
        )

    @classmethod
    def of_pose(cls, t_sensor_object: Array) -> Hold:
        """Hold with the angles of a pose, (4, 4); its lengths, which depend on part and gel, are 0."""
        axis = t_sensor_object[:3, 2]
        pitch_rad = float(np.arctan2(axis[1], axis[0])) - _QUARTER
        roll_rad = -float(np.arcsin(np.clip(axis[2], -1.0, 1.0)))
        straight = _turned(cls(pitch_rad, roll_rad, 0.0, 0.0, 0.0, 0.0))
        spin = straight[:3, :3].T @ t_sensor_object[:3, :3]
        return cls(pitch_rad, roll_rad, float(np.arctan2(spin[1, 0], spin[0, 0])), 0.0, 0.0, 0.0)


def lie(hold: Hold, surface_mm: Array, middle_mm: Array, tip_z_mm: float) -> Array:
    """Pose of a part in this hold, (4, 4) t_sensor_object.

    Parameters
    ----------
    hold
        The hold. The part reaches `hold.press_mm` into the gel.
    surface_mm
        Points of the part's surface, its frame, (N, 3) mm.
    middle_mm
        The middle of the gel's rest surface, sensor frame, (3,) mm.
    tip_z_mm
        Position of the tip along the part's z axis.
    """
    pose = _turned(hold)
    axis = pose[:3, 2]
    across = np.array([-axis[1], axis[0], 0.0]) / np.hypot(axis[0], axis[1])
    pose[:2, 3] = (middle_mm + hold.shift_mm * across - (tip_z_mm - hold.held_mm) * axis)[:2]
    return reaching(pose, surface_mm, middle_mm, middle_mm[2] - hold.press_mm)


def guesses(nominal: Hold, surface_mm: Array, patch_mm: Array, tip_z_mm: float) -> list[Array]:
    """Initial guesses of a pose from a contact patch (N, 3), mm: centred on the patch and aligned with it,
    otherwise nominal.

    The first guess lies along the patch's longer axis, if there is one, in the direction closer to the
    nominal pitch. The others have the pitches `_PITCHES_RAD`. Other parameters as in `lie`.
    """
    middle = patch_mm.mean(axis=0)
    spread = (patch_mm - middle)[:, :2]
    (short, long), vectors = np.linalg.eigh(spread.T @ spread)
    along = vectors[:, 1] if vectors[1, 1] >= 0.0 else -vectors[:, 1]
    first = float(np.arctan2(along[1], along[0])) - _QUARTER if long > _LONGER**2 * short else 0.0
    found = []
    for pitch_rad in (first, *_PITCHES_RAD):
        pose = _turned(replace(nominal, pitch_rad=pitch_rad))
        pose[:2, 3] = (middle - (tip_z_mm - nominal.held_mm) * pose[:3, 2])[:2]
        found.append(reaching(pose, surface_mm, middle, float(patch_mm[:, 2].min())))
    return found


def _turned(hold: Hold) -> Array:
    return _turn(2, _QUARTER + hold.pitch_rad) @ _turn(1, _QUARTER + hold.roll_rad) @ _turn(2, hold.spin_rad)


def reaching(pose: Array, surface_mm: Array, middle_mm: Array, nearest_mm: float) -> Array:
    """Move a pose along z until the part over the gel reaches the given z of the sensor frame."""
    placed = surface_mm @ pose[:3, :3].T + pose[:3, 3]
    over = np.all(np.abs(placed[:, :2] - middle_mm[:2]) < _GEL_HALF_MM, axis=1)
    pose[2, 3] += nearest_mm - placed[over, 2].min()
    return pose


def _turn(axis: int, angle_rad: float) -> Array:
    twist = np.zeros(6)
    twist[axis] = angle_rad
    return np.array(se3_exp(twist), np.float64)
