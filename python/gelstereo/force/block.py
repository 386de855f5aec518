"""Finite elements: a linear elastic block, bonded at its back, under tractions on its top.

Elements are boxes with quadratic displacement and a linear dilatation that is discontinuous between them.
That pair does not lock, up to incompressible gels (Boffi and Gastaldi 2002, "On the quadrilateral Q2-P1
element for the Stokes problem"). Young's modulus is 1, and the unit of tractions. The block is
mirror-symmetric: a quarter of it is meshed, and loads are the sum of four parts that are even or odd across
each plane of symmetry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Quarter", "lines", "solves"]

Array = npt.NDArray[np.float64]

#: Quadratic shape functions of an element from -1 to 1, of its nodes at -1, 0 and 1, and their derivatives.
_SHAPES: tuple[Callable[[Array], Array], Callable[[Array], Array]] = (
    lambda x: np.stack([x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2]),
    lambda x: np.stack([x - 0.5, -2 * x, x + 0.5]),
)
#: Loads solved at once, which bounds the memory and the time of a step.
_AT_ONCE = 64
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def solves(loads: int) -> int:
    """Number of steps of `Quarter.top`: a factorization, and solutions for some loads each."""
    return 1 + -(-loads // _AT_ONCE)


def lines(first_mm: float, until_mm: float, growth: float) -> Array:
    """Edges of elements from 0, the first of about this size, and each larger than the last by `growth`."""
    sizes = [first_mm]
    while sum(sizes) < until_mm * (1 - 1e-9):
        sizes.append(sizes[-1] * growth)
    edges = np.concatenate([[0.0], np.cumsum(sizes)])
    return np.asarray(edges * (until_mm / edges[-1]))


def _product(parts: list[Array]) -> Array:
    """Kronecker product of x, y and z; x changes fastest."""
    return np.asarray(np.kron(parts[2], np.kron(parts[1], parts[0])))


def _stiffness(size_mm: Array, poisson_ratio: float) -> Array:
    """(81, 81) of one element: three components of each of 27 nodes."""
    half = size_mm / 2
    shapes = [shape(_POINTS) for shape in _SHAPES]

    def over(i: int, j: int) -> Array:
        """Integrals of the derivatives along i and j of all pairs of shape functions."""
        orders = [(int(axis == i), int(axis == j)) for axis in range(3)]
        return _product(
            [
                (shapes[a] * _WEIGHTS) @ shapes[b].T * half[axis] ** (1 - a - b)
                for axis, (a, b) in enumerate(orders)
            ]
        )

    shear = 0.5 / (1 + poisson_ratio)
    lame = poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    stiff = np.zeros((27, 3, 27, 3))
    whole = shear * (over(0, 0) + over(1, 1) + over(2, 2))
    for i in range(3):
        stiff[:, i, :, i] += whole
        for j in range(3):
            stiff[:, i, :, j] += shear * over(j, i)
    # Projection of the dilatation onto 1, x, y and z.
    for moment in range(4):
        growth = np.zeros((27, 3))
        for i in range(3):
            parts = []
            for axis in range(3):
                a = int(axis == i)
                weights = _WEIGHTS * (_POINTS if axis == moment - 1 else 1.0)
                parts.append((shapes[a] * weights).sum(axis=1) * half[axis] ** (1 - a))
            growth[:, i] = _product(parts)
        norm = 8 * float(np.prod(half)) / (1.0 if moment == 0 else 3.0)
        stiff += lame / norm * growth[:, :, None, None] * growth[None, None]
    return stiff.reshape(81, 81)


@dataclass(frozen=True)
class Quarter:
    """Quarter of a block: edges of its elements along x and y from the planes of symmetry, and along z from
    the bonded back, mm.
    """

    edges_mm: tuple[Array, Array, Array]
    poisson_ratio: float
    #: Called after each step of `top`.
    step: Callable[[], None] = lambda: None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of nodes along x, y and z."""
        x, y, z = (2 * len(edges) - 1 for edges in self.edges_mm)
        return x, y, z

    def at(self, axis: int, place_mm: float) -> Array:
        """Weights of the nodes along an axis that interpolate displacement at a place."""
        edges = self.edges_mm[axis]
        e = int(np.clip(np.searchsorted(edges, place_mm, side="right") - 1, 0, len(edges) - 2))
        weights = np.zeros(2 * len(edges) - 1)
        place = 2 * (place_mm - edges[e]) / (edges[e + 1] - edges[e]) - 1
        weights[2 * e : 2 * e + 3] = _SHAPES[0](np.array([place]))[:, 0]
        return weights

    def over(self, axis: int, start_mm: float, end_mm: float) -> Array:
        """Integrals of the nodes' shape functions along an axis between two places."""
        edges = self.edges_mm[axis]
        weights = np.zeros(2 * len(edges) - 1)
        for e, (low, high) in enumerate(pairwise(edges)):
            a, b = max(low, start_mm), min(high, end_mm)
            if a < b:
                points = (a + b) / 2 + (b - a) / 2 * _POINTS
                inside = _SHAPES[0](2 * (points - low) / (high - low) - 1)
                weights[2 * e : 2 * e + 3] += inside @ _WEIGHTS * (b - a) / 2
        return weights

    def top(self, parity: tuple[int, int], forces: Array) -> Array:
        """Displacement of the top under nodal forces.

        Parameters
        ----------
        parity
            Of the loads across x = 0 and y = 0: 1 for an even load, -1 for an odd one. Under an even load,
            motion along the plane is even, and motion across it odd.
        forces
            (nodes of the top, 3, loads).
        """
        from scipy.sparse.linalg import splu

        x, y, z = self.shape
        nodes = np.arange(x * y * z).reshape(z, y, x)
        top = (3 * nodes[-1].ravel()[:, None] + np.arange(3)).ravel()
        is_held = np.zeros(3 * nodes.size, dtype=bool)
        is_held[: 3 * x * y] = True
        for axis, plane in enumerate((nodes[:, :, 0], nodes[:, 0, :])):
            components = [axis] if parity[axis] > 0 else [k for k in range(3) if k != axis]
            for component in components:
                is_held[3 * plane.ravel() + component] = True
        free = np.flatnonzero(~is_held)
        # Symmetric and positive definite: no pivoting.
        solver = splu(
            self.stiffness[free][:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        self.step()
        flat = forces.reshape(len(top), -1)
        moved = np.empty_like(flat)
        for start in range(0, flat.shape[1], _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            right = np.zeros((len(is_held), flat[:, some].shape[1]))
            right[top] = flat[:, some]
            right[free] = solver.solve(right[free])
            right[is_held] = 0.0
            moved[:, some] = right[top]
            self.step()
        return moved.reshape(forces.shape)

    @cached_property
    def stiffness(self) -> Any:
        """Sparse matrix of all nodes."""
        from scipy.sparse import coo_array

        x, y, z = self.shape
        sizes = [np.diff(edges) for edges in self.edges_mm]
        counts = [len(size) for size in sizes]
        inside = np.arange(3)
        local = ((inside[:, None, None] * y + inside[:, None]) * x + inside).ravel()
        corners = np.array([(2 * k * y + 2 * j) * x + 2 * i for k, j, i in np.ndindex(*counts[::-1])])
        kinds: dict[tuple[float, ...], Array] = {}
        blocks = []
        for k, j, i in np.ndindex(*counts[::-1]):
            size = np.array([sizes[0][i], sizes[1][j], sizes[2][k]])
            key = tuple(np.round(size, 9).tolist())
            if key not in kinds:
                kinds[key] = _stiffness(size, self.poisson_ratio)
            blocks.append(kinds[key].ravel())
        freedoms = (3 * (corners[:, None] + local)[:, :, None] + np.arange(3)).reshape(len(corners), 81)
        rows, columns = np.repeat(freedoms, 81, axis=1), np.tile(freedoms, (1, 81))
        count = 3 * x * y * z
        places = (rows.ravel(), columns.ravel())
        return coo_array((np.concatenate(blocks), places), shape=(count, count)).tocsr()
