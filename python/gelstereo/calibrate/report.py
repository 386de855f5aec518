"""Results of a calibration, with their evidence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .boards import Board
from .solve import Mono, Stereo

if TYPE_CHECKING:
    from gelstereo import Rig

__all__ = ["HeldOut", "PairReport", "Rectification", "StereoCalibration"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PairReport:
    """One pair of images."""

    #: Both file names.
    name: str
    #: Rms distance of the left and right view's corners from their projections in the joint calibration,
    #: pixels. ``None`` if the pair was not used.
    left_px: float | None
    right_px: float | None
    #: Whether the pair is an outlier.
    outlier: bool = False
    #: Reason why the pair was not used, or ``None``.
    problem: str | None = None


@dataclass(frozen=True)
class HeldOut:
    """Cross-validation errors, on pairs not used for calibration."""

    #: Rms distance of the right view's corners from the projection of the board located in the left view
    #: alone; pixels.
    transfer_px: float
    #: Rms error of the triangulated distance of neighbouring corners, relative to the true one, mm.
    square_mm: float
    #: Mean error of that distance, which indicates a scale error, mm.
    square_bias_mm: float


@dataclass(frozen=True)
class Rectification:
    """Row-aligned views as OpenCV computes them."""

    #: Rotations (3, 3) from left and right camera coordinates to rectified ones.
    r_left: Array
    r_right: Array
    #: Projections (3, 4) of the rectified cameras.
    p_left: Array
    p_right: Array
    #: Q of Eq. 3, (4, 4).
    q: Array


@dataclass(frozen=True)
class StereoCalibration:
    """A calibrated stereo pair with its quality figures."""

    #: Width and height, pixels.
    size_px: tuple[int, int]
    #: The board with its lengths.
    board: Board
    #: Separate calibration of each camera.
    left: Mono
    right: Mono
    #: Joint calibration of both cameras: the result.
    stereo: Stereo
    rectification: Rectification
    #: Every pair given, used or not, in the order of their numbers.
    pairs: tuple[PairReport, ...]
    #: ``None`` with fewer than eight used pairs.
    held_out: HeldOut | None
    #: Suggestions for a better calibration: coverage, tilt, number of pairs.
    hints: tuple[str, ...]

    @property
    def baseline_mm(self) -> float:
        """Distance between the cameras."""
        return float(np.linalg.norm(self.stereo.t_right_left_mm))

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the outlying pairs."""
        return tuple(pair.name for pair in self.pairs if pair.outlier)

    @property
    def used(self) -> int:
        """Number of pairs used."""
        return sum(pair.left_px is not None for pair in self.pairs)

    @property
    def rig(self) -> Rig:
        """The rig, as used by the pipeline.

        Raises
        ------
        RigError
            The calibrated values are not a valid rig.
        """
        from gelstereo import Rig

        return Rig.from_opencv(
            size_px=self.size_px,
            left_matrix=self.stereo.left_matrix,
            left_distortion=self.stereo.left_distortion,
            right_matrix=self.stereo.right_matrix,
            right_distortion=self.stereo.right_distortion,
            rotation=self.stereo.r_right_left,
            translation_mm=self.stereo.t_right_left_mm,
        )

    def save(self, path: str | Path) -> None:
        """Write the rig file (TOML)."""
        self.rig.save(path)

    def summary(self) -> str:
        """Write the report as plain text."""
        stereo = self.stereo
        lines = [
            f"{self.used} of {len(self.pairs)} pairs used, {self.board}, images "
            f"{self.size_px[0]}x{self.size_px[1]} px",
            f"rms      left {self.left.rms_px:.3f} px   right {self.right.rms_px:.3f} px   "
            f"stereo {stereo.rms_px:.3f} px",
            f"focal    left {stereo.left_matrix[0, 0]:.2f} px   right {stereo.right_matrix[0, 0]:.2f} px   "
            f"(standard deviation {self.left.focal_sigma_px:.2f} and {self.right.focal_sigma_px:.2f} px)",
            f"baseline {self.baseline_mm:.4f} mm",
        ]
        if self.held_out is not None:
            held = self.held_out
            lines.append(
                f"held out {held.transfer_px:.3f} px from view to view, squares off by "
                f"{1e3 * held.square_mm:.1f} um rms, {1e3 * held.square_bias_mm:+.1f} um in the mean"
            )
        lines += ["", "pair                              left px  right px"]
        lines += [_pair_line(pair) for pair in self.pairs]
        lines += [f"hint: {hint}" for hint in self.hints]
        return "\n".join(lines)


def _pair_line(pair: PairReport) -> str:
    if pair.left_px is None or pair.right_px is None:
        return f"{pair.name:<32}  not used: {pair.problem}"
    mark = "  outlier" if pair.outlier else ""
    return f"{pair.name:<32}  {pair.left_px:7.3f}  {pair.right_px:8.3f}{mark}"
