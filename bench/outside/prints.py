"""The print on a gel: a lattice of dots with errors of position and size, on a deformable surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

Array = npt.NDArray[np.float64]

ROWS = COLS = 25
# The print's middle in world coordinates, between the cameras.
MIDDLE_MM = np.array([4.0, 0.0])


@dataclass(frozen=True)
class Print:
    """Dots of a stencil print. Errors are normal: 8 um per axis in position, 3 % in radius."""

    pitch_mm: float
    radius_mm: float
    seed: int
    place_sigma_mm: float = 0.008
    radius_sigma: float = 0.03
    paper: float = 0.72
    ink: float = 0.09

    @property
    def half_mm(self) -> float:
        """Half the printed square's side: the lattice and 0.7 mm more."""
        return 0.5 * (COLS - 1) * self.pitch_mm + 0.7

    def dots(self) -> tuple[Array, Array]:
        """Centres (rows x columns, in order; n x 2, mm from the print's middle) and radii."""
        rng = np.random.default_rng(self.seed)
        along = (np.arange(COLS) - 0.5 * (COLS - 1)) * self.pitch_mm
        y, x = np.meshgrid(along, along, indexing="ij")
        centres = np.stack((x.ravel(), y.ravel()), axis=1)
        centres = centres + rng.normal(0, self.place_sigma_mm, centres.shape)
        return centres, self.radius_mm * (1 + rng.normal(0, self.radius_sigma, len(centres)))

    def reflectance(self, texels: int = 2048) -> Array:
        """Reflectance on a square grid of texels; dots' rims are anti-aliased over one texel."""
        cell = 2 * self.half_mm / texels
        middle = (np.arange(texels) + 0.5) * cell - self.half_mm
        image = np.full((texels, texels), self.paper)
        for (x, y), radius in zip(*self.dots(), strict=True):
            across, down = (
                slice(*(int((c + side * (radius + 2 * cell) + self.half_mm) / cell) for side in (-1, 1)))
                for c in (x, y)
            )
            beyond = np.hypot(middle[None, across] - x, middle[down, None] - y) - radius
            share = np.clip(0.5 - beyond / cell, 0.0, 1.0)
            image[down, across] += (self.ink - self.paper) * share
        return image


@dataclass(frozen=True)
class Skin:
    """The print's surface as a mesh: vertices of a square grid (n x n x 3, world, mm); `half_mm` as the
    print's.
    """

    vertices_mm: Array
    half_mm: float

    @classmethod
    def moved(
        cls, along_mm: Array, motion_mm: Array, half_mm: float, surface_mm: float, step_mm: float = 0.1
    ) -> Skin:
        """Move the print's points by a field on a square grid of material coordinates.

        `along_mm` are the grid's coordinates from the print's middle, the same for x and y; `motion_mm` is
        n x n x 3 with rows along y. Values between are cubic splines.
        """
        count = 2 * round(half_mm / step_mm) + 1
        at = np.linspace(-half_mm, half_mm, count)
        inside = np.clip(at, along_mm[0], along_mm[-1])
        field = [RectBivariateSpline(along_mm, along_mm, motion_mm[..., k])(inside, inside) for k in range(3)]
        y, x = np.meshgrid(at, at, indexing="ij")
        z = np.full_like(x, surface_mm)
        return cls(
            np.stack((x + MIDDLE_MM[0], y + MIDDLE_MM[1], z), axis=-1) + np.stack(field, axis=-1), half_mm
        )

    @classmethod
    def flat(cls, half_mm: float, surface_mm: float) -> Skin:
        """The print at rest."""
        along = np.linspace(-half_mm, half_mm, 5)
        return cls.moved(along, np.zeros((5, 5, 3)), half_mm, surface_mm)

    def triangles(self) -> npt.NDArray[np.uint32]:
        """Two triangles per cell, with the diagonal from its first to its last corner, facing the cameras."""
        n = len(self.vertices_mm)
        index = np.arange(n * n, dtype=np.uint32).reshape(n, n)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        two = [np.stack((a, d, b), axis=-1), np.stack((a, c, d), axis=-1)]
        return np.concatenate([t.reshape(-1, 3) for t in two])

    def at(self, material_mm: Array) -> Array:
        """Positions (n x 3, world) on the mesh's triangles of points of the print (n x 2, mm from its
        middle).
        """
        n = len(self.vertices_mm)
        scaled = (material_mm + self.half_mm) / (2 * self.half_mm) * (n - 1)
        cell = np.clip(np.floor(scaled).astype(int), 0, n - 2)
        (u, v), (i, j) = (scaled - cell).T[:, :, None], cell.T
        a, b, c, d = (self.vertices_mm[j + dj, i + di] for dj, di in ((0, 0), (0, 1), (1, 0), (1, 1)))
        upper = a + u * (b - a) + v * (d - b)
        lower = a + v * (c - a) + u * (d - c)
        return np.asarray(np.where(u >= v, upper, lower))

    def normals(self, material_mm: Array, reach_mm: float = 0.05) -> Array:
        """Unit normals that point away from the cameras (n x 3)."""
        dx, dy = (
            self.at(material_mm + step) - self.at(material_mm - step)
            for step in (np.array([reach_mm, 0]), np.array([0, reach_mm]))
        )
        normal = np.cross(dx, dy)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
