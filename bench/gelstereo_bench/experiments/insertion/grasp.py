"""Parts in the middle of a gripper: how they may lie, what the sensor sees of them, and what is guessed at first.

The part lies across the gel with its tip down, towards the sensor frame's +y, between two parallel fingers. Pitch is
its turn within the gel's plane (from the nominal direction), roll its tilt out of that plane; both names are the
paper's (Fig. 15, Rx and Ry of the sensor).
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

#: Half the gel's side that parts press on, mm.
_GEL_HALF_MM = 10.0
#: A patch has a longer axis when it spreads so many times as far along it.
_LONGER = 1.5
#: Guesses that owe nothing to the patch's outline.
_PITCHES_RAD = (-0.5, 0.0, 0.5)


@dataclass(frozen=True)
class Grasped:
    """A part that is grasped and inserted."""

    name: str
    #: As in the paper, (a) to (e).
    letter: str
    make: Callable[[], trimesh.Trimesh]
    #: How far behind its tip a part is held, mm: from and to.
    held_mm: tuple[float, float]
    #: Turns about its axis in which parallel fingers hold it, rad, and how far it may be turned from them.
    faces_rad: tuple[float, ...]
    spin_rad: float
    #: How deep it is inserted, and what the hole's width has over the part's, mm.
    depth_mm: float
    clearance_mm: float
    #: Turns of the hand about the axis of the standing part, rad, after which fingers hold it again.
    again_rad: tuple[float, ...]
    #: As often as in the paper (section V-A).
    trials: int = 36


_QUARTER = 0.5 * np.pi
#: A hexagon with a corner on +x lies on a flat when it is turned by half a side.
_FLAT = np.pi / 6.0
#: Fingers that close on a face turn the part to them, nearly.
_SEATED = 0.05


def _turns(first_rad: float, count: int) -> tuple[float, ...]:
    return tuple(first_rad + 2.0 * np.pi * k / count for k in range(count))


#: An irregular cap lies on two of its lobes where its height over a plane is least; on one it would roll.
_ON_LOBES = 2.4


#: A hand that is turned so far about a part's axis holds it again: anywhere, on the next face, or by its other side.
_ANY_WAY, _NEXT_SIDES, _SIXTHS, _EITHER_SIDE = (
    (0.0, _QUARTER),
    (0.0, _QUARTER),
    _turns(0.0, 6)[:3],
    (0.0, np.pi),
)

#: The paper's pegs; its clearances are below 0.3 mm.
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
        # Only one of its two wide sides fits the socket.
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
        """Least distance of the inserted part from the walls, mm; below 0 it does not go in."""
        return self.hole.room_mm(self.end, t_hole_object)


def fit_of(letter: str) -> Fit:
    """Make the part of a letter and its hole."""
    part = GRASPED[letter]
    mesh = part.make()
    end = InsertedEnd.of(mesh)
    return Fit(part, mesh, end, Hole.around(end, part.depth_mm, part.clearance_mm))


@dataclass(frozen=True)
class GraspRanges:
    """Where a part may lie; everything is drawn evenly."""

    pitch_rad: float = 0.8
    roll_rad: float = 0.05
    #: Across its axis, from the middle of the gel.
    shift_mm: float = 2.0
    #: How far the fingers press it into the gel.
    press_mm: tuple[float, float] = (0.8, 1.4)


@dataclass(frozen=True)
class Hold:
    """How a part lies in the hand."""

    pitch_rad: float
    roll_rad: float
    spin_rad: float
    shift_mm: float
    held_mm: float
    press_mm: float

    @classmethod
    def nominal(cls, part: Grasped, ranges: GraspRanges) -> Hold:
        """Lie in the middle, straight but for a little pitch: the grasp that is taught.

        An edge that lies along a row of markers is known to a pitch only; one that crosses the rows, to a part of it.
        """
        return cls(
            0.1, 0.0, part.faces_rad[0], 0.0, float(np.mean(part.held_mm)), float(np.mean(ranges.press_mm))
        )

    @classmethod
    def drawn(cls, part: Grasped, ranges: GraspRanges, random: np.random.Generator) -> Hold:
        """Lie somewhere within the ranges."""
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
        """Angles of a part at a pose, (4, 4); the lengths, which depend on the part and the gel, are 0."""
        axis = t_sensor_object[:3, 2]
        pitch_rad = float(np.arctan2(axis[1], axis[0])) - _QUARTER
        roll_rad = -float(np.arcsin(np.clip(axis[2], -1.0, 1.0)))
        straight = _turned(cls(pitch_rad, roll_rad, 0.0, 0.0, 0.0, 0.0))
        spin = straight[:3, :3].T @ t_sensor_object[:3, :3]
        return cls(pitch_rad, roll_rad, float(np.arctan2(spin[1, 0], spin[0, 0])), 0.0, 0.0, 0.0)


def lie(hold: Hold, surface_mm: Array, middle_mm: Array, tip_z_mm: float) -> Array:
    """Pose of a part that is held so, (4, 4) t_sensor_object.

    Parameters
    ----------
    hold
        How it lies. It reaches `hold.press_mm` into the gel.
    surface_mm
        Points of the part's surface, its frame, (N, 3) mm.
    middle_mm
        The middle of the gel's rest surface, sensor frame, (3,) mm.
    tip_z_mm
        Where its tip is along its own z axis.
    """
    pose = _turned(hold)
    axis = pose[:3, 2]
    across = np.array([-axis[1], axis[0], 0.0]) / np.hypot(axis[0], axis[1])
    pose[:2, 3] = (middle_mm + hold.shift_mm * across - (tip_z_mm - hold.held_mm) * axis)[:2]
    return reaching(pose, surface_mm, middle_mm, middle_mm[2] - hold.press_mm)


def guesses(nominal: Hold, surface_mm: Array, patch_mm: Array, tip_z_mm: float) -> list[Array]:
    """First guesses of a pose from a contact patch (N, 3), mm: upon it, along it, and otherwise as is nominal.

    The first lies along the patch's longer axis, taken in the direction closer to the nominal pitch, if it has one; the
    others at `_PITCHES_RAD`. The rest is as for `lie`.
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
    """Move a pose along z until what lies over the gel reaches that depth of the sensor frame."""
    placed = surface_mm @ pose[:3, :3].T + pose[:3, 3]
    over = np.all(np.abs(placed[:, :2] - middle_mm[:2]) < _GEL_HALF_MM, axis=1)
    pose[2, 3] += nearest_mm - placed[over, 2].min()
    return pose


def _turn(axis: int, angle_rad: float) -> Array:
    twist = np.zeros(6)
    twist[axis] = angle_rad
    return np.array(se3_exp(twist), np.float64)
