"""The surface of an unknown part, which grows from its contacts.

`gelstereo.MotionTracker.surface` gives the surface in each frame of a contact. `PartSurface` merges them,
and writes them as PLY or STL.
"""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import ShapeError, Template, TemplateError
from gelstereo._native import Recognition, recognize_surface

__all__ = ["PartSurface", "Recognition", "RecognitionStatus"]

_Floats = npt.NDArray[np.float64]

#: Corners of a disc in an STL file, and its radius in voxels. Points of a flat surface that fills each voxel
#: with one point are at most 0.71 voxels from the nearest one.
_CORNERS, _RADIUS = 6, 0.75


class RecognitionStatus(IntEnum):
    """Whether a contact is recognized, as in `Recognition.status`.

    Examples
    --------
    >>> RecognitionStatus(0).name
    'FOUND'
    """

    FOUND = 0
    """The pose is the only likely one, and noise explains the residuals."""
    AMBIGUOUS = 1
    """Another pose is as likely."""
    MISFIT = 2
    """Noise does not explain the residuals."""
    TOO_LITTLE = 3
    """Less than half of the points have a counterpart, or fewer than eight."""


class PartSurface:
    """Points of a part's surface with normals, merged by voxel and weighted by information.

    Parameters
    ----------
    voxel_mm : float
        Side of a voxel; each holds one point. The mean of points on a surface of radius R is up to
        ``voxel_mm**2 / (8 R)`` too deep: 2 um for 0.3 mm and 6 mm.

    Raises
    ------
    ShapeError
        If the voxel is not a positive length.

    Examples
    --------
    >>> surface = PartSurface(voxel_mm=0.5)
    >>> surface.add([[0.1, 0.0, 1.0], [0.2, 0.1, 1.2]], [[0.0, 0.0, 1.0]] * 2, [0.01, 0.01])
    >>> surface.points_mm.round(3).tolist()
    [[0.15, 0.05, 1.1]]
    """

    def __init__(self, voxel_mm: float = 0.3) -> None:
        if not 0.0 < voxel_mm < np.inf:
            raise ShapeError(f"the voxel is {voxel_mm} mm wide; valid is a positive length")
        self.voxel_mm = float(voxel_mm)
        self._keys = np.empty((0, 3), np.int64)
        #: Weight, weighted sums of points and of normals.
        self._sums = np.empty((0, 7))

    def __len__(self) -> int:
        return len(self._keys)

    def __repr__(self) -> str:
        return f"<PartSurface: {len(self)} points, {self.voxel_mm:g} mm apart>"

    def add(self, points_mm: npt.ArrayLike, normals: npt.ArrayLike, sigma_mm: npt.ArrayLike) -> None:
        """Merge points of one frame.

        Parameters
        ----------
        points_mm : (M, 3) array_like
            Part frame.
        normals : (M, 3) array_like
            Unit normals out of the part.
        sigma_mm : (M,) array_like
            Standard deviations along the normals.

        Raises
        ------
        ShapeError
            If the shapes differ, a number is not finite, or a standard deviation is not positive.
        """
        points, out, sigma = _checked(points_mm, normals, sigma_mm)
        count = len(points)
        weight = 1.0 / sigma[:, None] ** 2
        keys = np.vstack([self._keys, np.floor(points / self.voxel_mm).astype(np.int64)])
        sums = np.vstack([self._sums, weight * np.hstack([np.ones((count, 1)), points, out])])
        self._keys, index = np.unique(keys, axis=0, return_inverse=True)
        self._sums = np.zeros((len(self._keys), 7))
        np.add.at(self._sums, index.reshape(-1), sums)

    @property
    def points_mm(self) -> _Floats:
        """(M, 3) weighted means of the points in each voxel, part frame."""
        return np.asarray(self._sums[:, 1:4] / self._sums[:, :1])

    @property
    def normals(self) -> _Floats:
        """(M, 3) unit normals out of the part; zero where those of a voxel cancel."""
        length = np.linalg.norm(self._sums[:, 4:], axis=1, keepdims=True)
        out = np.zeros((len(self), 3))
        np.divide(self._sums[:, 4:], length, out=out, where=length > 0.0)
        return out

    @property
    def sigma_mm(self) -> _Floats:
        """(M,) standard deviations along the normals, of independent errors. Those of poses are not
        independent, and are not in it.
        """
        return np.asarray(1.0 / np.sqrt(self._sums[:, 0]))

    def recognize(
        self,
        points_mm: npt.ArrayLike,
        normals: npt.ArrayLike,
        sigma_mm: npt.ArrayLike,
        *,
        guess: npt.ArrayLike,
        guess_sigma: tuple[float, float] = (0.1, 0.5),
        spacing_mm: float = 0.9,
        surface_sigma_mm: float = 0.005,
    ) -> Recognition:
        """Find where the surface of a new contact is on this one.

        Parameters
        ----------
        points_mm, normals, sigma_mm : array_like
            Surface of the contact, in its frame; see `add`.
        guess : (4, 4) array_like
            Expected pose that moves this surface onto the contact, such as that by the gripper's motion.
        guess_sigma : (float, float)
            Its standard deviations in radians and millimetres, at the contact.
        spacing_mm : float
            Distance of neighbours in the contact.
        surface_sigma_mm : float
            Standard deviation of the distance of both surfaces, in addition to the noise of their points.

        Returns
        -------
        Recognition
            With a status that a program can branch on. Directions that the surface does not determine keep
            the guess and its variance.

        Raises
        ------
        ShapeError
            If there are no points, or a number is not valid.
        PoseError
            If the guess is not a pose.
        """
        points, out, sigma = _checked(points_mm, normals, sigma_mm)
        known = np.hstack([self.points_mm, self.normals, self.sigma_mm[:, None]])
        contact = np.hstack([points, out, sigma[:, None]])
        settings = {"spacing_mm": spacing_mm, "surface_sigma_mm": surface_sigma_mm}
        found = recognize_surface(known, contact, guess, guess_sigma, **settings)
        if found is None:
            raise ShapeError(
                f"the surface has {len(self)} points, the contact {len(points)}, the guess deviations "
                f"{guess_sigma} and the spacing is {spacing_mm} mm; valid are points with normals, and "
                "positive numbers"
            )
        return found

    def template(self) -> Template:
        """A template of what is known of the part.

        Raises
        ------
        TemplateError
            If there are no points, or a normal is zero.
        """
        if len(self) == 0:
            raise TemplateError("the surface has no points; add those of a contact first")
        return Template.from_points(self.points_mm, self.normals, self.voxel_mm)

    def write_ply(self, path: str | Path) -> None:
        """Write points, normals and standard deviations as binary PLY, in millimetres and single precision.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        names = ("x", "y", "z", "nx", "ny", "nz", "sigma")
        head = ["ply", "format binary_little_endian 1.0", "comment lengths in mm"]
        head += [f"element vertex {len(self)}", *(f"property float {name}" for name in names), "end_header"]
        rows = np.hstack([self.points_mm, self.normals, self.sigma_mm[:, None]]).astype("<f4")
        Path(path).write_bytes(("\n".join(head) + "\n").encode("ascii") + rows.tobytes())

    def write_stl(self, path: str | Path) -> None:
        """Write a disc of six triangles for each point as binary STL, in millimetres.

        The discs overlap, and are not joined: STL has no points.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        points, normals = self.points_mm, self.normals
        # Any axis that is not along the normal gives a tangent.
        axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
        u = np.cross(normals, axis)
        u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
        v = np.cross(normals, u)
        angle = 2.0 * np.pi * np.arange(_CORNERS) / _CORNERS
        radius = _RADIUS * self.voxel_mm
        rim = points[:, None] + radius * (
            np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]
        )
        triangles = np.zeros(
            (len(self), _CORNERS), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
        )
        triangles["normal"] = normals[:, None]
        triangles["corners"][..., 0, :] = points[:, None]
        triangles["corners"][..., 1, :] = rim
        triangles["corners"][..., 2, :] = np.roll(rim, -1, axis=1)
        count = np.uint32(triangles.size).astype("<u4").tobytes()
        Path(path).write_bytes(b"discs in mm".ljust(80) + count + triangles.tobytes())


def _checked(
    points_mm: npt.ArrayLike, normals: npt.ArrayLike, sigma_mm: npt.ArrayLike
) -> tuple[_Floats, _Floats, _Floats]:
    """Points of one frame as arrays."""
    points, out = np.asarray(points_mm, np.float64), np.asarray(normals, np.float64)
    sigma = np.asarray(sigma_mm, np.float64)
    count = len(sigma) if sigma.ndim == 1 else -1
    if points.shape != (count, 3) or out.shape != (count, 3):
        raise ShapeError(
            f"the points have shape {points.shape}, the normals {out.shape} and the standard deviations "
            f"{sigma.shape}; valid is (M, 3), (M, 3) and (M,)"
        )
    if not (np.isfinite(points).all() and np.isfinite(out).all() and np.all((sigma > 0) & (sigma < 1e9))):
        raise ShapeError(
            "a point, a normal or a standard deviation is not finite, or a standard deviation is not "
            "positive; leave such points out"
        )
    return points, out, sigma
