"""Surfaces under a rigid part by simple laws: no shoulder, an exponential one, and a stretched membrane.

Heights are above the gel's back; the free surface is at the thickness. There is no lateral motion.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from .parts import Posed

Array = npt.NDArray[np.float64]


def underside(part: Posed, along_mm: Array, surface_mm: float) -> Array:
    """Depth of the part below the free surface at every point of a square grid (0 beside it)."""
    y, x = np.meshgrid(along_mm, along_mm, indexing="ij")
    low = np.full_like(x, surface_mm - 5.0)
    inside = np.zeros(x.shape, dtype=bool)
    # Sphere tracing upwards until the part is reached; the signed distance is a safe step.
    for _ in range(200):
        points = np.stack((x.ravel(), y.ravel(), low.ravel()), axis=1)
        gap = part.distance(points).reshape(x.shape)
        inside = gap < 1e-6
        low = np.minimum(low + np.where(inside, 0.0, gap), surface_mm)
        if np.all(inside | (low >= surface_mm)):
            break
    return np.asarray(surface_mm - low)


def exponential(depth: Array, along_mm: Array, length_mm: float) -> Array:
    """Height from the points in contact: the maximum of depth times exp(-distance / length)."""
    y, x = np.meshgrid(along_mm, along_mm, indexing="ij")
    points = np.stack((x.ravel(), y.ravel()), axis=1)
    pressed = depth.ravel() > 0
    sources, levels = points[pressed], depth.ravel()[pressed]
    found = depth.ravel().copy()
    for part in np.array_split(np.arange(len(points)), 100):
        far = np.hypot(*(points[part, None] - sources[None]).transpose(2, 0, 1))
        found[part] = np.maximum(found[part], (levels * np.exp(-far / length_mm)).max(axis=1))
    return found.reshape(depth.shape)


def membrane(depth: Array, along_mm: Array, length_mm: float) -> Array:
    """A membrane on springs (tension over stiffness = length^2), pushed by an obstacle, with fixed edges.

    The obstacle problem u >= depth, u - length^2 laplacian(u) >= 0 by the primal-dual active set
    (Hintermueller, Ito and Kunisch 2002), which ends after finitely many sets.
    """
    n, step = len(along_mm), float(along_mm[1] - along_mm[0])
    second = diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(n, n)) / step**2
    one = eye_array(n)
    operator = (kron(one, one) - length_mm**2 * (kron(second, one) + kron(one, second))).tocsr()
    obstacle = np.where(depth > 0, depth, -1.0).ravel()
    active = obstacle > 0
    for _ in range(100):
        u = np.where(active, obstacle, 0.0)
        free = np.flatnonzero(~active)
        rest = operator[free][:, free].tocsc()
        u[free] = splu(rest).solve(-(operator[free] @ u))
        push = operator @ u
        changed = np.where(active, push > 0, u < obstacle)
        if np.array_equal(changed, active):
            break
        active = changed
    return np.asarray(u.reshape(depth.shape))


LAWS = {
    "none": lambda depth, along, length: depth,
    "exponential": exponential,
    "membrane": membrane,
}
