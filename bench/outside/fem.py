"""Finite elements: a soft layer, bonded at its back, under a rigid part with friction.

Neo-Hookean, nearly incompressible: bilinear elements whose pressure is constant in each (mean dilatation; Simo,
Taylor and Pister 1985), so that they do not lock. Contact is collocated at surface nodes with a penalty; friction
is Coulomb's with return mapping. Loads are steps of the part's motion, each solved by Newton's method. The shear
modulus is 1; pressures are in its unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import skfem
from scipy.sparse import csr_matrix

from .parts import Posed

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Of the shear modulus, per mm: surfaces interpenetrate by 0.5 to 3 um at the pressures of these contacts.
NORMAL_PENALTY = 2000.0
# Sticking nodes give way by up to 10 to 20 um at those pressures; 200 made Newton steps fail.
STICK_PENALTY = 100.0


class NotConverged(RuntimeError):
    """Newton's method did not converge, even with the smallest step of the part's motion."""


def solve(matrix: csr_matrix, right: Array) -> Array:
    """One sparse linear system; PARDISO, since SuperLU takes ten times as long in three dimensions."""
    import pypardiso

    return np.asarray(pypardiso.spsolve(matrix, right))


@dataclass
class Layer:
    """The mesh of a layer: a block (hexahedra) or a disc by its half section (quadrilaterals, r and z)."""

    mesh: skfem.Mesh
    thickness_mm: float
    poisson_ratio: float
    fixed: Indices = field(init=False)

    def __post_init__(self) -> None:
        self.axial = self.mesh.p.shape[0] == 2
        scalar = skfem.ElementQuad1() if self.axial else skfem.ElementHex1()
        basis = skfem.Basis(self.mesh, skfem.ElementVector(scalar), intorder=2 if not self.axial else 3)
        r = np.asarray(basis.global_coordinates())[0]
        # F = 1 + rates u: nine entries of every element's gradient by its degrees of freedom.
        self.rates = np.stack([self._gradient(f[0], r) for f in basis.basis], axis=-1)
        self.weights = basis.dx * (r if self.axial else 1.0)
        self.dofs: Indices = basis.element_dofs.T.astype(np.int64)
        self.count = basis.N
        self.nodal: Indices = basis.nodal_dofs.T.astype(np.int64)
        self.bulk = 2 * (1 + self.poisson_ratio) / (3 * (1 - 2 * self.poisson_ratio))
        self._surface(scalar)
        held = self.mesh.p[-1] < 1e-9
        fixed = [self.nodal[held].ravel()]
        if self.axial:
            fixed.append(self.nodal[self.mesh.p[0] < 1e-9, 0])
        self.fixed = np.unique(np.concatenate(fixed))
        self.free = np.setdiff1d(np.arange(self.count), self.fixed)

    def _gradient(self, u: skfem.DiscreteField, r: Array) -> Array:
        d, value = np.asarray(u.grad), np.asarray(u)
        full = np.zeros((*d.shape[2:], 9))
        if self.axial:
            full[..., 0], full[..., 2], full[..., 6], full[..., 8] = d[0, 0], d[0, 1], d[1, 0], d[1, 1]
            full[..., 4] = value[0] / r
        else:
            full[...] = np.moveaxis(d, (0, 1), (-2, -1)).reshape(*d.shape[2:], 9)
        return full

    def _surface(self, scalar: skfem.Element) -> None:
        """Nodes of the free surface in order, their places and the areas that they stand for."""
        top = self.mesh.facets_satisfying(lambda x: np.abs(x[-1] - self.thickness_mm) < 1e-9)
        facets = skfem.FacetBasis(self.mesh, scalar, facets=top, intorder=3)

        @skfem.LinearForm
        def area(v: skfem.DiscreteField, w: skfem.FormExtraParams) -> Array:
            return v * (w.x[0] if self.axial else 1.0)

        areas = area.assemble(facets)
        nodes = np.flatnonzero(np.abs(self.mesh.p[-1] - self.thickness_mm) < 1e-9)
        keys = self.mesh.p[:-1, nodes]
        self.nodes = nodes[np.lexsort(keys)]
        self.areas = areas[self.nodes]
        places = self.mesh.p[:, self.nodes].T
        self.places = np.insert(places, 1, 0.0, axis=1) if self.axial else places
        self.surface_dofs = self.nodal[self.nodes]

    def forces(self, u: Array) -> tuple[Array, csr_matrix]:
        """Inner forces and their derivative."""
        gradient = np.eye(3).ravel() + np.einsum("eqai,ei->eqa", self.rates, u[self.dofs])
        f = gradient.reshape(*gradient.shape[:2], 3, 3)
        jacobian = np.linalg.det(f)
        if jacobian.min() <= 0.05:
            raise NotConverged
        inverse = np.linalg.inv(f).swapaxes(-1, -2).reshape(gradient.shape)
        volume = self.weights.sum(axis=1)
        theta = (self.weights * jacobian).sum(axis=1) / volume
        pressure = 0.5 * self.bulk * (theta - 1 / theta)
        stiff = 0.5 * self.bulk * (1 + 1 / theta**2) / volume
        first = (gradient**2).sum(axis=-1)
        scale = jacobian ** (-2 / 3)
        # dW/dF of the isochoric part, and of the pressure's work on the volume.
        isochoric = scale[..., None] * (gradient - first[..., None] / 3 * inverse)
        cofactor = jacobian[..., None] * inverse
        stress = self.weights[..., None] * (isochoric + pressure[:, None, None] * cofactor)
        inner = np.einsum("eqa,eqai->ei", stress, self.rates)
        law = self._law(gradient, inverse, first, scale, jacobian, pressure)
        law *= self.weights[..., None, None]
        along = np.matmul(law, self.rates)
        n, q, _, m = self.rates.shape
        blocks = np.matmul(self.rates.reshape(n, q * 9, m).swapaxes(1, 2), along.reshape(n, q * 9, m))
        growth = np.einsum("eqa,eqai->ei", self.weights[..., None] * cofactor, self.rates)
        blocks += stiff[:, None, None] * growth[:, :, None] * growth[:, None, :]
        forces = np.bincount(self.dofs.ravel(), inner.ravel(), self.count)
        rows = np.broadcast_to(self.dofs[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(self.dofs[:, None, :], blocks.shape).ravel()
        return forces, csr_matrix((blocks.ravel(), (rows, columns)), shape=(self.count,) * 2)

    @staticmethod
    def _law(
        gradient: Array, inverse: Array, first: Array, scale: Array, jacobian: Array, pressure: Array
    ) -> Array:
        """Second derivative of the energy by F, the mean dilatation's own part apart."""
        outer = inverse[..., :, None] * inverse[..., None, :]
        # d(F^-T)/dF: -F^-T_kj F^-T_il for entries ij by kl.
        g = inverse.reshape(*inverse.shape[:-1], 3, 3)
        turn = np.einsum("...kj,...il->...ijkl", g, g).reshape(outer.shape)
        mixed = gradient[..., :, None] * inverse[..., None, :]
        law = np.eye(9) - 2 / 3 * (mixed + mixed.swapaxes(-1, -2))
        law = law + (first / 3)[..., None, None] * (2 / 3 * outer + turn)
        law *= scale[..., None, None]
        law += (pressure[:, None] * jacobian)[..., None, None] * (outer - turn)
        return np.asarray(law)


@dataclass(frozen=True)
class Solved:
    """Motion of all degrees of freedom (mm), and at the surface's nodes pressures and tractions."""

    motion: Array
    pressures: Array
    tractions: Array


@dataclass
class Contact:
    """Forces between the surface's nodes and a part. `held` are the tractions that nodes carried last."""

    layer: Layer
    friction: float
    held: Array = field(init=False)

    def __post_init__(self) -> None:
        self.held = np.zeros_like(self.layer.places)

    def forces(
        self, u: Array, before: Array, part: Posed, part_before: Posed
    ) -> tuple[Array, Array, Array, Array]:
        """Forces on the nodes (n x 3), their derivative (n x 3 x 3), normal pressures and tangential tractions."""
        layer = self.layer
        places, places_before = (layer.places + self._vectors(v) for v in (u, before))
        gap = part.distance(places)
        touching = gap < 0
        forces, slopes = np.zeros_like(places), np.zeros((len(places), 3, 3))
        pressures, tractions = np.zeros(len(places)), np.zeros_like(places)
        if not touching.any():
            return forces, slopes, pressures, tractions
        x, area = places[touching], layer.areas[touching]
        normal, bend = part.slope(x), part.curvature(x)
        pressure = -NORMAL_PENALTY * gap[touching]
        across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        slid = (x - places_before[touching]) - part.carried(x, part_before)
        trial = np.einsum("nij,nj->ni", across, self.held[touching] - STICK_PENALTY * slid)
        # Coulomb's limit, rounded: Newton's method cycles at the sharp one.
        limit = self.friction * pressure + 1e-9
        size2 = (trial**2).sum(axis=1)
        both = np.sqrt(limit**2 + size2)
        share = limit / both
        traction = share[:, None] * trial
        slope = -NORMAL_PENALTY * normal[:, :, None] * normal[:, None, :] + pressure[:, None, None] * bend
        hold = share[:, None, None] * across - (limit / both**3)[:, None, None] * (
            trial[:, :, None] * trial[:, None, :]
        )
        slope -= STICK_PENALTY * hold
        rise = self.friction * NORMAL_PENALTY * size2 / both**3
        slope -= rise[:, None, None] * trial[:, :, None] * normal[:, None, :]
        forces[touching] = area[:, None] * (pressure[:, None] * normal + traction)
        slopes[touching] = area[:, None, None] * slope
        pressures[touching], tractions[touching] = pressure, traction
        return forces, slopes, pressures, tractions

    def _vectors(self, u: Array) -> Array:
        values = u[self.layer.surface_dofs]
        return np.insert(values, 1, 0.0, axis=1) if self.layer.axial else values

    def step(self, start: Array, part: Posed, part_before: Posed, limit: int = 25) -> Solved:
        """Move the part. The step counts, and friction remembers it, once it has converged."""
        layer = self.layer
        kept = [0, 2] if layer.axial else [0, 1, 2]
        ends = layer.surface_dofs
        rows = np.broadcast_to(ends[:, :, None], (*ends.shape, ends.shape[1])).ravel()
        columns = np.broadcast_to(ends[:, None, :], (*ends.shape, ends.shape[1])).ravel()

        def evaluate(u: Array) -> tuple[Array, csr_matrix, float, Array, Array]:
            inner, stiffness = layer.forces(u)
            outer, slopes, pressures, tractions = self.forces(u, start, part, part_before)
            np.subtract.at(inner, ends.ravel(), outer[:, kept].ravel())
            block = slopes[:, kept][:, :, kept].ravel()
            matrix = stiffness - csr_matrix((block, (rows, columns)), shape=stiffness.shape)
            scale = float(np.linalg.norm(outer)) + 1e-9
            return inner[layer.free], matrix[layer.free][:, layer.free].tocsr(), scale, pressures, tractions

        u = start.copy()
        residual, matrix, scale, pressures, tractions = evaluate(u)
        for _ in range(limit):
            size = float(np.linalg.norm(residual))
            if size < 1e-5 * scale:
                self.held = tractions
                return Solved(u, pressures, tractions)
            change = solve(matrix, -residual)
            # Far jumps at first touch overshoot.
            share = min(1.0, 0.5 / float(np.abs(change).max()))
            for _ in range(5):
                tried = u.copy()
                tried[layer.free] += share * change
                try:
                    residual, matrix, scale, pressures, tractions = evaluate(tried)
                except NotConverged:
                    share *= 0.5
                    continue
                if np.linalg.norm(residual) < (1 - 0.1 * share) * size:
                    break
                share *= 0.5
            u = tried
        raise NotConverged


def graded(fine_mm: float, fine_until_mm: float, until_mm: float, growth: float = 1.25) -> Array:
    """Coordinates from 0 whose steps are `fine_mm` and then grow."""
    steps, at = [fine_mm] * int(np.ceil(fine_until_mm / fine_mm)), 0.0
    at = sum(steps)
    while at < until_mm:
        steps.append(steps[-1] * growth)
        at += steps[-1]
    return np.concatenate(([0.0], np.cumsum(steps))) * (until_mm / at)


def heights(fine_mm: float, thickness_mm: float, growth: float = 1.35) -> Array:
    """Coordinates from the back to the surface, finest at the surface."""
    return thickness_mm - graded(fine_mm, 2 * fine_mm, thickness_mm, growth)[::-1]


def disc(
    thickness_mm: float, poisson_ratio: float, half_mm: float, fine_mm: float, contact_mm: float
) -> Layer:
    """A disc of gel for contacts round its axis."""
    r = graded(fine_mm, contact_mm, half_mm, 1.15)
    z = heights(fine_mm, thickness_mm, 1.15)
    return Layer(skfem.MeshQuad.init_tensor(r, z), thickness_mm, poisson_ratio)


def block(
    thickness_mm: float, poisson_ratio: float, half_mm: float, fine_mm: float, contact_mm: tuple[float, float]
) -> Layer:
    """A square block of gel."""
    axes = [graded(fine_mm, reach, half_mm, 1.6) for reach in contact_mm]
    x, y = (np.concatenate((-a[:0:-1], a)) for a in axes)
    z = heights(fine_mm, thickness_mm)
    return Layer(skfem.MeshHex.init_tensor(x, y, z), thickness_mm, poisson_ratio)
