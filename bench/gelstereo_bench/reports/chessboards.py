"""Real chessboards: our calibration and mrcal's on the same corners, and the board's shape according to each
rig.

Run ``python -m gelstereo_bench.reports.chessboards --data FOLDER`` to fill docs/real-chessboards.md. mrcal is
Debian's package of that name (https://mrcal.secretsauce.net). Without it the comparison is left out, and the
page states that.
"""

from __future__ import annotations

import argparse
import ast
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, Rig, triangulate
from gelstereo.calibrate import StereoCalibration, calibrate_corners, pair_images
from gelstereo.calibrate.corners import CornerFinder
from gelstereo.calibrate.observe import observe
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = [
    "BOARD",
    "Boards",
    "Flatness",
    "calibrate",
    "flatness",
    "main",
    "read_corners",
    "triangulate_opencv",
    "triangulate_rig",
]

Array = npt.NDArray[np.float64]

#: Inner corners (columns, rows). The unit of length is one square, because its side is not documented.
BOARD = (9, 6)
_MRCAL = "mrcal-calibrate-cameras"


@dataclass(frozen=True)
class Boards:
    """Corners of all pairs, (columns * rows, 2) each, in one numbering."""

    left_px: list[Array]
    right_px: list[Array]
    size_px: tuple[int, int]


@dataclass(frozen=True)
class Flatness:
    """Shape of the triangulated boards with a rig, in squares, over all corners of all pairs."""

    #: Rms distance from each board's plane.
    plane_rms: float
    #: Mean and standard deviation of the distance of neighbouring corners; the true value is 1.
    side_mean: float
    side_sigma: float


def read_corners(folder: Path) -> Boards:
    """Find the corners of all pairs in a folder of ``left01.jpg``, ``right01.jpg`` and so on."""
    pairs = pair_images(sorted(folder.glob("left??.jpg")), sorted(folder.glob("right??.jpg")))
    with CornerFinder(10.0) as finder:
        found = observe(pairs, BOARD, finder, lambda done, total, what: None)
    both = [
        (o.left.corners_px, o.right.corners_px)
        for o in found
        if o.left.corners_px is not None and o.right.corners_px is not None
    ]
    if not both:
        raise Error(f"{folder} has no pair that shows a whole board of {BOARD[0]}x{BOARD[1]} inner corners")
    return Boards([left for left, _ in both], [right for _, right in both], found[0].left.size_px)


def calibrate(boards: Boards) -> StereoCalibration:
    """Calibrate with gelstereo, lengths in squares."""
    return calibrate_corners(
        boards.left_px, boards.right_px, size_px=boards.size_px, board=BOARD, square_mm=1.0
    )


def triangulate_rig(rig: Rig, left_px: Array, right_px: Array) -> Array:
    """Corners in space by gelstereo's triangulation, with a wide epipolar limit for noisy corners."""
    params = Params().replace({"triangulate.max_epipolar_px": 10.0})
    return triangulate(rig, left_px, right_px, params)


def triangulate_opencv(rig: Rig, left_px: Array, right_px: Array) -> Array:
    """Corners in space by ``cv2.triangulatePoints`` on undistorted corners."""
    left = cv2.undistortPoints(left_px[:, None], rig.left_matrix, rig.left_distortion)[:, 0]
    right = cv2.undistortPoints(right_px[:, None], rig.right_matrix, rig.right_distortion)[:, 0]
    homogeneous = cv2.triangulatePoints(np.eye(3, 4), rig.t_right_left[:3], left.T, right.T)
    return np.asarray((homogeneous[:3] / homogeneous[3]).T, float)


def flatness(boards_mm: Sequence[Array]) -> Flatness:
    """Measure how flat and how square triangulated boards are."""
    cols, rows = BOARD
    off, sides = [], []
    for points in boards_mm:
        centred = points - points.mean(axis=0)
        off.append(centred @ np.linalg.svd(centred)[2][2])
        grid = points.reshape(rows, cols, 3)
        sides += [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    side = np.concatenate(sides)
    # The plane fit uses three degrees of freedom per board.
    freedom = sum(len(o) - 3 for o in off)
    rms = float(np.sqrt(sum(float((o**2).sum()) for o in off) / freedom))
    return Flatness(rms, float(side.mean()), float(side.std()))


def mrcal_rig(boards: Boards) -> tuple[Rig, float] | None:
    """Calibrate the same corners with mrcal: its rig and rms error in 2-D pixels, or `None` if it is not
    installed.
    """
    program = shutil.which(_MRCAL)
    if program is None:
        return None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_corners(folder / "corners.vnl", boards)
        command = [program, "--corners-cache", "corners.vnl", "--lensmodel", "LENSMODEL_OPENCV5"]
        command += ["--focal", str(0.8 * boards.size_px[0]), "--imagersize", *map(str, boards.size_px)]
        command += ["--object-spacing", "1", "--object-width-n", str(BOARD[0])]
        command += ["--object-height-n", str(BOARD[1])]
        # As in OpenCV, the board is flat, and no corner is rejected.
        command += ["--skip-calobject-warp-solve", "--skip-outlier-rejection", "left*.jpg", "right*.jpg"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise Error(f"{_MRCAL} failed: {done.stderr.strip().splitlines()[-1:]}")
        models = [ast.literal_eval((folder / f"camera-{i}.cameramodel").read_text()) for i in (0, 1)]
    final = [line for line in (done.stdout + done.stderr).splitlines() if "RMS error:" in line][-1]
    # mrcal's error is per coordinate.
    return _rig_of(models, boards.size_px), float(final.split(":")[1]) * float(np.sqrt(2.0))


def _write_corners(path: Path, boards: Boards) -> None:
    lines = ["# filename x y level"]
    for view, corners in (("left", boards.left_px), ("right", boards.right_px)):
        for index, board in enumerate(corners):
            lines += [f"{view}{index:02d}.jpg {x:.9f} {y:.9f} 0" for x, y in board]
    path.write_text("\n".join(lines) + "\n")


def _rig_of(models: Sequence[dict[str, list[float]]], size_px: tuple[int, int]) -> Rig:
    """Rig from two camera models: fx, fy, cx, cy, k1, k2, p1, p2, k3 and a rotation vector with
    translation.
    """
    cameras, poses = [], []
    for model in models:
        fx, fy, cx, cy, *distortion = model["intrinsics"]
        cameras.append((np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(distortion)))
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array(model["extrinsics"][:3], float))[0]
        pose[:3, 3] = model["extrinsics"][3:]
        poses.append(pose)
    t_right_left = poses[1] @ np.linalg.inv(poses[0])
    (left_matrix, left_distortion), (right_matrix, right_distortion) = cameras
    return Rig.from_opencv(
        size_px=size_px,
        left_matrix=left_matrix,
        left_distortion=left_distortion,
        right_matrix=right_matrix,
        right_distortion=right_distortion,
        rotation=t_right_left[:3, :3],
        translation_mm=t_right_left[:3, 3],
    )


def main(arguments: list[str] | None = None) -> int:
    """Fill docs/real-chessboards.md."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.reports.chessboards", description=__doc__
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the real images")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    boards = read_corners(options.data / "opencv_stereo_chess")
    ours = calibrate(boards)
    opinions = [("gelstereo (OpenCV's solver)", ours.rig, ours.stereo.rms_px)]
    second = mrcal_rig(boards)
    if second is None:
        print(f"{_MRCAL} is not installed (apt-get install mrcal): no second opinion")
    else:
        opinions.append(("mrcal", *second))
    rows = [_row(name, rig, rms_px, boards) for name, rig, rms_px in opinions]
    head = ["calibrated by", "stereo rms px", "f left px", "f right px", "baseline squares"]
    head += ["plane rms: ours / OpenCV", "square: ours / OpenCV"]
    replace_between(options.docs / "real-chessboards.md", "chessboards", table(head, rows))
    return 0


def _row(name: str, rig: Rig, rms_px: float, boards: Boards) -> list[str]:
    measured = [
        flatness([method(rig, *pair) for pair in zip(boards.left_px, boards.right_px, strict=True)])
        for method in (triangulate_rig, triangulate_opencv)
    ]
    focal = [f"{matrix[0, 0]:.2f} / {matrix[1, 1]:.2f}" for matrix in (rig.left_matrix, rig.right_matrix)]
    return [
        name,
        f"{rms_px:.4f}",
        *focal,
        f"{rig.baseline_mm:.4f}",
        " / ".join(f"{m.plane_rms:.5f}" for m in measured),
        " / ".join(f"{m.side_mean:.5f} ± {m.side_sigma:.5f}" for m in measured),
    ]


if __name__ == "__main__":
    raise SystemExit(main())
