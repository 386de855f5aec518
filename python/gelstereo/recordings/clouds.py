"""A recording of point clouds, independent of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import RestSurface
from gelstereo.view.messages import RecordingError

__all__ = ["CloudRecording", "RecordingError"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class CloudRecording:
    """Clouds of one lattice over time, in the sensor frame: z points away from the camera."""

    #: Source of the recording.
    name: str
    rows: int
    cols: int
    #: Markers (frames, rows * cols, 3); marker ``row * cols + col`` has that index.
    points_mm: Array
    #: Markers (rows * cols, 3) when nothing touches the gel.
    rest_mm: Array
    #: Times (frames,), seconds, not decreasing.
    time_s: Array
    #: Frame numbers (frames,) of the recorder, increasing; a missing number is a lost frame. `None` if no
    #: frame was lost.
    sequence: Integers | None = None

    def __post_init__(self) -> None:
        """Check that the arrays are consistent."""
        markers = self.rows * self.cols
        if self.points_mm.ndim != 3 or self.points_mm.shape[1:] != (markers, 3):
            raise RecordingError(
                f"{self.name}: points have shape {self.points_mm.shape}; valid is (frames, {markers}, 3)"
            )
        if self.rest_mm.shape != (markers, 3):
            raise RecordingError(
                f"{self.name}: the rest frame has shape {self.rest_mm.shape}; valid is ({markers}, 3)"
            )
        if self.time_s.shape != (len(self),):
            raise RecordingError(f"{self.name}: {len(self.time_s)} times for {len(self)} frames")
        for what, array in (("points", self.points_mm), ("rest frame", self.rest_mm), ("times", self.time_s)):
            if not np.isfinite(array).all():
                raise RecordingError(f"{self.name}: the {what} contain NaN or infinity")
        if (np.diff(self.time_s) < 0.0).any():
            frame = int(np.argmin(np.diff(self.time_s))) + 1
            raise RecordingError(f"{self.name}: time runs backwards at frame {frame}")
        if self.sequence is not None:
            if self.sequence.shape != (len(self),):
                raise RecordingError(f"{self.name}: {len(self.sequence)} numbers for {len(self)} frames")
            if (np.diff(self.sequence) <= 0).any():
                frame = int(np.argmax(np.diff(self.sequence) <= 0)) + 1
                raise RecordingError(f"{self.name}: the frames' numbers do not increase at frame {frame}")

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.points_mm)

    @property
    def pitch_mm(self) -> float:
        """Median distance of neighbours in the rest frame."""
        grid = self.rest_mm.reshape(self.rows, self.cols, 3)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
        return float(np.median(np.concatenate(steps)))

    @property
    def lost_before(self) -> npt.NDArray[np.bool_]:
        """Whether the recorder lost one or more frames just before each frame (frames,)."""
        lost = np.zeros(len(self), bool)
        if self.sequence is not None:
            lost[1:] = np.diff(self.sequence) > 1
        return lost

    def indentation_mm(self) -> Array:
        """Height (frames, rows * cols) of every marker over its rest height, positive towards the camera."""
        rest = RestSurface(self.rest_mm)
        return np.array([rest.indentation_mm(points) for points in self.points_mm])
