"""Reading of stored contacts: displacement, true contact and pressure at any point of the print."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator, RectBivariateSpline, RegularGridInterpolator

Array = npt.NDArray[np.float64]

DATA = Path(__file__).parent / "data" / "contacts"


@dataclass(frozen=True)
class Field:
    """All stages of one part on one gel, from `data/contacts`."""

    meta: dict[str, Any]
    arrays: dict[str, Array]

    @classmethod
    def load(cls, name: str, folder: Path = DATA) -> Field:
        """One file by its name."""
        with np.load(folder / f"{name}.npz") as file:
            arrays = {key: file[key].astype(np.float64) for key in file.files if key != "meta"}
            return cls(json.loads(str(file["meta"])), arrays)

    @property
    def stages(self) -> list[list[float]]:
        """Depth, motion along x and y (mm) and twist (degrees) of every stage."""
        return list(self.meta["stages"])

    def _round(self, stage: int, points: Array) -> tuple[Array, Array, Array]:
        far = np.hypot(*points.T)
        r = self.arrays["r"]
        along = PchipInterpolator(r, self.arrays["motion"][stage])(np.minimum(far, r[-1]))
        outward = points / np.maximum(far, 1e-9)[:, None]
        return far, outward, along

    def motion(self, stage: int, points: Array) -> Array:
        """Displacement (n x 3, mm) of surface points (n x 2, mm from the part's first touch)."""
        if "r" in self.arrays:
            _, outward, along = self._round(stage, points)
            return np.concatenate((outward * along[:, :1], along[:, 1:]), axis=1)
        x, y = self.arrays["x"], self.arrays["y"]
        inside = np.clip(points, (x[0], y[0]), (x[-1], y[-1]))
        grids = self.arrays["motion"][stage]
        order = 1 if "law" in self.meta else 3
        splines = [RectBivariateSpline(y, x, grids[..., k], kx=order, ky=order) for k in range(3)]
        return np.stack([s(inside[:, 1], inside[:, 0], grid=False) for s in splines], axis=1)

    def pressure(self, stage: int, points: Array) -> Array:
        """Normal pressure over the shear modulus (n); for laws without pressure, 1 in contact."""
        grid = self.arrays["pressure"][stage]
        if "r" in self.arrays:
            return np.asarray(np.interp(np.hypot(*points.T), self.arrays["r"], grid, right=0.0))
        axes = (self.arrays["y"], self.arrays["x"])
        return np.asarray(
            RegularGridInterpolator(axes, grid, bounds_error=False, fill_value=0.0)(points[:, ::-1])
        )

    def touching(self, stage: int, points: Array) -> npt.NDArray[np.bool_]:
        """True contact: most of the surrounding gel carries pressure. Accurate to half a cell."""
        grid = (self.arrays["pressure"][stage] > 0).astype(float)
        # For blocks, the fraction in contact of the surface around every node.
        grid = self.arrays["share"][stage] if "share" in self.arrays else grid
        if "r" in self.arrays:
            return np.asarray(np.interp(np.hypot(*points.T), self.arrays["r"], grid, right=0.0) > 0.5)
        axes = (self.arrays["y"], self.arrays["x"])
        share = RegularGridInterpolator(axes, grid, bounds_error=False, fill_value=0.0)(points[:, ::-1])
        # More than half, because a single column of contact points is half of a node's, up to rounding.
        return np.asarray(share > 0.501)
