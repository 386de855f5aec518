"""Estimated forces of a real sensor beside those that its own software stated.

The recordings of the wheel pytac3d have the vendor's force on each marker. How it was computed is not
documented, and no scale was used: shape, signs and ranks are compared, with one scale for all components in
place of the unknown modulus. Springs under the markers, with a stiffness of their own along and across the
gel, are the baseline.

Run ``python -m gelstereo_bench.reports.vendor_forces`` to fill docs/force.md; it needs the wheel (``pip
install --no-deps pytac3d==3.3.0.9``).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import ForceEstimator, Params, RestSurface
from gelstereo.extras import needs
from gelstereo.recordings import CloudRecording, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.recordings import SALIENCY_MM

with needs(__name__):
    from scipy.stats import spearmanr

__all__ = ["RECORDINGS", "Agreement", "agreement", "main"]

Array = npt.NDArray[np.float64]

RECORDINGS = (
    ("example_1", "AD2-0065L"),
    ("example_2", "HDL1-GWH0021"),
    ("example_2", "HDL1-GWH0022"),
)
#: The gels are not documented.
_THICKNESSES_MM = (4.0, 6.0, 9.0)
#: Noise of a marker at rest, mm.
_SIGMA_MM = np.array([0.001, 0.001, 0.004])
_EVERY = 3
#: Fewest markers of a contact.
_FEWEST = 8


@dataclass(frozen=True)
class Agreement:
    """Forces of markers in contact and beside it, estimated and stated by the vendor."""

    frames: int
    #: Shares of the squares of the vendor's forces that one scale explains: pressing, and along the gel.
    pressing: float
    along: float
    #: Along the gel, with a scale of its own.
    along_own: float
    #: The same of springs, with two stiffnesses.
    spring_pressing: float
    spring_along: float
    #: Spearman's rank correlation: pressing, along x, along y.
    ranks: tuple[float, float, float]
    #: Share of equal signs along the gel, of the larger half of the vendor's forces.
    signs: float


def agreement(folder: Path, thickness_mm: float, every: int = _EVERY) -> Agreement:
    """Compare frames of a recording, on a layer of this thickness."""
    recording = load_pytac3d(folder)
    stated = np.load(folder / "3D_Forces.npy", allow_pickle=False).astype(np.float64)
    frames, ours = _estimated(recording, thickness_mm, every)
    loaded = np.any(ours != 0.0, axis=2)
    estimated, theirs = ours[loaded], stated[frames][loaded]
    moved = (recording.points_mm[frames] - recording.rest_mm)[loaded]
    scale = float(np.sum(estimated * theirs) / np.sum(estimated**2))
    pressing, along = slice(2, 3), slice(0, 2)
    ranks = [float(spearmanr(estimated[:, k], theirs[:, k]).statistic) for k in (2, 0, 1)]
    strong = np.abs(theirs[:, along]) > np.median(np.abs(theirs[:, along]))
    same = np.sign(estimated[:, along]) == np.sign(theirs[:, along])
    return Agreement(
        len(frames),
        _share(scale * estimated[:, pressing], theirs[:, pressing]),
        _share(scale * estimated[:, along], theirs[:, along]),
        _scaled(estimated[:, along], theirs[:, along]),
        _scaled(moved[:, pressing], theirs[:, pressing]),
        _scaled(moved[:, along], theirs[:, along]),
        (ranks[0], ranks[1], ranks[2]),
        float(np.mean(same[strong])),
    )


def _estimated(recording: CloudRecording, thickness_mm: float, every: int) -> tuple[list[int], Array]:
    """Every so many frames with contact, and the tractions (F, N, 3) of these."""
    touching = recording.indentation_mm() > SALIENCY_MM
    frames = [int(frame) for frame in np.flatnonzero(touching.sum(axis=1) >= _FEWEST)[::every]]
    count = len(recording.rest_mm)
    settings = {"method": "ridge", "thickness_mm": thickness_mm, "young_kpa": 100.0}
    estimator = ForceEstimator(
        RestSurface(recording.rest_mm),
        Params().replace(force=settings),
        cols=recording.cols,
        covariance_mm2=np.tile(1e-12 * np.eye(3), (count, 1, 1)),
    )
    noise = np.tile(np.diag(_SIGMA_MM**2), (count, 1, 1))
    found = [
        estimator.run(recording.points_mm[frame], noise, touching[frame].tolist())[0] for frame in frames
    ]
    return frames, np.array(found)


def _share(predicted: Array, stated: Array) -> float:
    return float(1.0 - np.sum((stated - predicted) ** 2) / np.sum(stated**2))


def _scaled(predicted: Array, stated: Array) -> float:
    scale = np.sum(predicted * stated) / np.sum(predicted**2)
    return _share(scale * predicted, stated)


def main(arguments: list[str] | None = None) -> int:
    """Fill the table in docs/force.md."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.reports.vendor_forces", description=__doc__
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    head = [
        "recording",
        "thickness, mm",
        "frames",
        "pressing, %",
        "along the gel, %",
        "with its own scale, %",
    ]
    head += [
        "springs: pressing, %",
        "along the gel, %",
        "ranks: pressing",
        "along x",
        "along y",
        "equal signs, %",
    ]
    rows = []
    for example, sensor in RECORDINGS:
        for thickness_mm in _THICKNESSES_MM:
            found = agreement(pytac3d_example(example, sensor), thickness_mm)
            shares = (found.pressing, found.along, found.along_own, found.spring_pressing, found.spring_along)
            rows.append(
                [sensor, f"{thickness_mm:g}", str(found.frames)]
                + [f"{100.0 * share:.0f}" for share in shares]
                + [f"{rank:.2f}" for rank in found.ranks]
                + [f"{100.0 * found.signs:.0f}"]
            )
    replace_between(options.docs / "force.md", "vendor", table(head, rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
