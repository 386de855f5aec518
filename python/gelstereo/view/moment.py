"""Data for the picture of one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from gelstereo._native import Frame

Floats = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """The located part: its surface in the sensor frame.

    Attributes
    ----------
    vertices_mm : (V, 3) float64
        Sensor frame.
    triangles : (F, 3) int64
        Counter-clockwise seen from outside.
    """

    vertices_mm: Floats
    triangles: Triangles

    @classmethod
    def located(
        cls, vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike, t_sensor_object: npt.ArrayLike
    ) -> Part:
        """Transform a part from the object frame to its pose."""
        pose = np.asarray(t_sensor_object, dtype=np.float64)
        moved = np.asarray(vertices_mm, dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]
        return cls(moved, np.asarray(triangles, dtype=np.int64))


@dataclass(frozen=True)
class Moment:
    """One stereo frame, its results, and the part if it was located.

    Attributes
    ----------
    left : (H, W) uint8
        Left image.
    rows, cols : int
        Size of the lattice; marker ``row * cols + col`` has that index.
    left_px, reference_px : (N, 2) float64
        Markers in the left image, now and at rest.
    points_mm : (N, 3) float64
        Sensor frame.
    indentation_mm : (N,) float64
    state : (N,) uint8
        `gelstereo.MarkerState`.
    salient : (N,) bool
    part : Part, optional
    title : str
    notes : sequence of str
        Lines under the title, for example the pose.
    part_edges_px : (E, 2, 2) float64, optional
        Edges of the part in the left image.
    """

    left: npt.NDArray[np.uint8]
    rows: int
    cols: int
    left_px: Floats
    reference_px: Floats
    points_mm: Floats
    indentation_mm: Floats
    state: npt.NDArray[np.uint8]
    salient: npt.NDArray[np.bool_]
    part: Part | None = None
    title: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    part_edges_px: Floats | None = None

    @classmethod
    def of(
        cls,
        left: npt.NDArray[np.uint8],
        frame: Frame,
        reference_px: Floats,
        lattice: tuple[int, int],
        *,
        part: Part | None = None,
        title: str = "",
        notes: Sequence[str] = (),
    ) -> Moment:
        """A moment from a pipeline's frame; `lattice` is (rows, cols)."""
        return cls(
            left=left,
            rows=lattice[0],
            cols=lattice[1],
            left_px=frame.left_px,
            reference_px=reference_px,
            points_mm=frame.points_mm,
            indentation_mm=frame.indentation_mm,
            state=frame.state,
            salient=frame.salient,
            part=part,
            title=title,
            notes=notes,
        )

    def titled(self, title: str) -> Moment:
        """The same moment with another title."""
        return replace(self, title=title)


def pose_in_words(t_sensor_object: npt.ArrayLike) -> str:
    """Position and rotation vector of a part in the sensor frame, as text.

    Examples
    --------
    >>> pose_in_words(np.eye(4))
    'sensor frame: position (0.00, 0.00, 0.00) mm, rotation vector (0.0, 0.0, 0.0) deg'
    """
    from gelstereo._native import se3_log

    pose = np.asarray(t_sensor_object, dtype=np.float64)
    turn = np.degrees(se3_log(pose)[:3])

    def numbers(values: Floats, digits: int) -> str:
        # Adding zero turns -0.0 into 0.0.
        return ", ".join(f"{round(float(v), digits) + 0.0:.{digits}f}" for v in values)

    position, rotation = numbers(pose[:3, 3], 2), numbers(turn, 1)
    return f"sensor frame: position ({position}) mm, rotation vector ({rotation}) deg"
