"""Finite elements: a soft layer, bonded at its back, under a rigid part with friction.

The material is neo-Hookean and nearly incompressible. Bilinear elements with constant pressure (mean
dilatation; Simo, Taylor and Pister 1985) avoid locking. Contact is evaluated with a penalty, at a disc's
surface nodes or at four points of each face of a block. Friction is Coulomb's with return mapping. Loads are
steps of the part's motion, each solved by Newton's method with a line search. The shear modulus is 1 and is
the unit of pressures.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import skfem
from scipy.sparse import csr_matrix, identity

from .parts import Posed

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Normal penalty in shear moduli per mm: surfaces interpenetrate by 0.5 to 3 um at the pressures of these
# contacts.
NORMAL_PENALTY = 2000.0
# Tangential penalty: sticking nodes move by up to 10 to 20 um at those pressures. With 200, Newton steps
# failed.
STICK_PENALTY = 100.0
# Blocks: the pressure starts as a parabola over this depth, and the part's curvature is included up to this
# pressure.
SOFT_MM = 0.002
MAX_BEND_PRESSURE = 20.0


class NotConverged(RuntimeError):
    """Newton's method did not converge, even with the smallest step of the part's motion."""


def solve(matrix: csr_matrix, right: Array) -> Array:
    """Solve a sparse linear system with PARDISO, because SuperLU takes ten times as long in three
    dimensions.
    """
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
        # F = 1 + rates u: nine entries of every element's deformation gradient per degree of freedom.
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
        """Nodes of the free surface in order, their positions and tributary areas."""
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
        # Contact points: a disc's nodes, or four points of every face of a block.
        self.at_points, self.point_areas = identity(len(self.nodes), format="csr"), self.areas
        if not self.axial:
            self.at_points, self.point_areas = self._points(facets)

    def _points(self, facets: skfem.FacetBasis) -> tuple[csr_matrix, Array]:
        """Gauss points of the surface's faces as weights of its nodes, and their areas."""
        order = np.full(self.mesh.p.shape[1], -1)
        order[self.nodes] = np.arange(len(self.nodes))
        shares = np.stack([np.asarray(f[0]) for f in facets.basis], axis=-1)
        columns = order[np.asarray(facets.element_dofs).T][:, None, :]
        columns = np.broadcast_to(columns, shares.shape).reshape(-1, shares.shape[-1])
        shares = shares.reshape(columns.shape)
        rows = np.broadcast_to(np.arange(len(shares))[:, None], shares.shape)
        used = columns >= 0
        places = (rows[used], columns[used])
        points = csr_matrix((shares[used], places), shape=(len(shares), len(self.nodes)))
        return points, np.asarray(facets.dx).ravel()

    def forces(self, u: Array) -> Array:
        """Internal forces."""
        bent = _Bent.of(self, u)
        stress = self.weights[..., None] * (bent.isochoric() + bent.pressure[:, None, None] * bent.cofactor)
        inner = np.einsum("eqa,eqai->ei", stress, self.rates)
        return np.bincount(self.dofs.ravel(), inner.ravel(), self.count)

    def stiffness(self, u: Array) -> csr_matrix:
        """Derivative of the internal forces."""
        bent = _Bent.of(self, u)
        law = bent.law()
        law *= self.weights[..., None, None]
        along = np.matmul(law, self.rates)
        n, q, _, m = self.rates.shape
        blocks = np.matmul(self.rates.reshape(n, q * 9, m).swapaxes(1, 2), along.reshape(n, q * 9, m))
        growth = np.einsum("eqa,eqai->ei", self.weights[..., None] * bent.cofactor, self.rates)
        stiff = 0.5 * self.bulk * (1 + 1 / bent.theta**2) / self.weights.sum(axis=1)
        blocks += stiff[:, None, None] * growth[:, :, None] * growth[:, None, :]
        rows = np.broadcast_to(self.dofs[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(self.dofs[:, None, :], blocks.shape).ravel()
        return csr_matrix((blocks.ravel(), (rows, columns)), shape=(self.count,) * 2)


@dataclass(frozen=True)
class _Bent:
    """A layer's deformation: F and its inverse transpose as nine entries, and derived quantities."""

    gradient: Array
    inverse: Array
    jacobian: Array
    theta: Array
    pressure: Array

    @classmethod
    def of(cls, layer: Layer, u: Array) -> _Bent:
        gradient = np.eye(3).ravel() + np.einsum("eqai,ei->eqa", layer.rates, u[layer.dofs])
        f = gradient.reshape(*gradient.shape[:2], 3, 3)
        jacobian = np.linalg.det(f)
        if jacobian.min() <= 0.05:
            raise NotConverged
        inverse = np.linalg.inv(f).swapaxes(-1, -2).reshape(gradient.shape)
        theta = (layer.weights * jacobian).sum(axis=1) / layer.weights.sum(axis=1)
        return cls(gradient, inverse, jacobian, theta, 0.5 * layer.bulk * (theta - 1 / theta))

    @property
    def cofactor(self) -> Array:
        return self.jacobian[..., None] * self.inverse

    def isochoric(self) -> Array:
        """dW/dF of the isochoric part."""
        first = (self.gradient**2).sum(axis=-1)
        scale = self.jacobian ** (-2 / 3)
        return np.asarray(scale[..., None] * (self.gradient - first[..., None] / 3 * self.inverse))

    def law(self) -> Array:
        """Second derivative of the energy with respect to F, without the term of the mean dilatation."""
        gradient, inverse = self.gradient, self.inverse
        outer = inverse[..., :, None] * inverse[..., None, :]
        # d(F^-T)/dF: -F^-T_kj F^-T_il for entries ij by kl.
        g = inverse.reshape(*inverse.shape[:-1], 3, 3)
        turn = np.einsum("...kj,...il->...ijkl", g, g).reshape(outer.shape)
        mixed = gradient[..., :, None] * inverse[..., None, :]
        law = np.eye(9) - 2 / 3 * (mixed + mixed.swapaxes(-1, -2))
        law = law + ((gradient**2).sum(axis=-1) / 3)[..., None, None] * (2 / 3 * outer + turn)
        law *= (self.jacobian ** (-2 / 3))[..., None, None]
        law += (self.pressure[:, None] * self.jacobian)[..., None, None] * (outer - turn)
        return np.asarray(law)


@dataclass(frozen=True)
class Solved:
    """Displacements of all degrees of freedom (mm); at the surface's nodes pressures, tractions and fraction
    in contact.
    """

    motion: Array
    pressures: Array
    tractions: Array
    shares: Array


@dataclass(frozen=True)
class Traction:
    """Tractions on the surface at the contact points, and their derivatives with respect to the points'
    positions.
    """

    stresses: Array
    slopes: Array
    pressures: Array
    tangential: Array


@dataclass
class Contact:
    """Forces between the surface's contact points and a part. `held` are the tractions of the
    previous step.
    """

    layer: Layer
    friction: float
    held: Array = field(init=False)

    def __post_init__(self) -> None:
        self.held = np.zeros((self.layer.at_points.shape[0], 3))

    def places(self, u: Array) -> Array:
        """Positions of the contact points."""
        layer = self.layer
        values = u[layer.surface_dofs]
        moved = np.insert(values, 1, 0.0, axis=1) if layer.axial else values
        return np.asarray(layer.at_points @ (layer.places + moved))

    def forces(self, places: Array, places_before: Array, part: Posed, part_before: Posed) -> Traction:
        """Penalty stresses at the contact points, with friction for the motion since the last step."""
        gap = part.distance(places)
        touching = gap < 0
        stresses, slopes = np.zeros_like(places), np.zeros((len(places), 3, 3))
        pressures, tractions = np.zeros(len(places)), np.zeros_like(places)
        if not touching.any():
            return Traction(stresses, slopes, pressures, tractions)
        x = places[touching]
        normal, bend = part.slope(x), part.curvature(x)
        pressure, rate = self._pressure(-gap[touching])
        across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        slid = (x - places_before[touching]) - part.carried(x, part_before)
        trial = np.einsum("nij,nj->ni", across, self.held[touching] - STICK_PENALTY * slid)
        # Coulomb's limit, smoothed: Newton's method cycles at the sharp one.
        limit = self.friction * pressure + 1e-9
        size2 = (trial**2).sum(axis=1)
        both = np.sqrt(limit**2 + size2)
        share = limit / both
        traction = share[:, None] * trial
        slope = -rate[:, None, None] * normal[:, :, None] * normal[:, None, :]
        # Iterates may be far inside the part, where the true factor would dominate the gel's stiffness.
        slope += np.minimum(pressure, MAX_BEND_PRESSURE)[:, None, None] * bend
        hold = share[:, None, None] * across - (limit / both**3)[:, None, None] * (
            trial[:, :, None] * trial[:, None, :]
        )
        slope -= STICK_PENALTY * hold
        rise = self.friction * rate * size2 / both**3
        slope -= rise[:, None, None] * trial[:, :, None] * normal[:, None, :]
        stresses[touching] = pressure[:, None] * normal + traction
        slopes[touching] = slope
        pressures[touching], tractions[touching] = pressure, traction
        return Traction(stresses, slopes, pressures, tractions)

    def _pressure(self, depth: Array) -> tuple[Array, Array]:
        """Penalty pressure at a depth in the part, and its derivative: linear, in 3-D with a soft start."""
        soft = 0.0 if self.layer.axial else SOFT_MM
        if soft == 0.0:
            return NORMAL_PENALTY * depth, np.full_like(depth, NORMAL_PENALTY)
        inside = np.minimum(depth, soft)
        pressure = NORMAL_PENALTY * (0.5 * inside**2 / soft + (depth - inside))
        return pressure, NORMAL_PENALTY * inside / soft

    def step(self, start: Array, guess: Array, part: Posed, part_before: Posed, limit: int = 25) -> Solved:
        """Move the part. The state, including friction's history, is updated only if the step converges."""
        problem = _Step(self, self.places(start), part, part_before)
        free = self.layer.free
        u = guess.copy()
        now = problem.at(u)
        for _ in range(limit):
            if np.linalg.norm(now.residual) < 1e-5 * now.scale:
                self.held = now.traction.tangential
                return self._solved(u, now.traction)
            change = np.zeros_like(u)
            change[free] = solve(problem.matrix(u, now.traction), -now.residual)
            u, now = problem.search(u, change, now)
        raise NotConverged

    def _solved(self, u: Array, traction: Traction) -> Solved:
        """Averages around every node."""
        layer = self.layer
        spread = layer.at_points.T.multiply(layer.point_areas).tocsr()
        area = np.asarray(spread.sum(axis=1)).ravel()
        touching = (traction.pressures > 0).astype(float)
        pressures, shares = spread @ traction.pressures / area, spread @ touching / area
        return Solved(u, pressures, (spread @ traction.tangential) / area[:, None], shares)


@dataclass(frozen=True)
class _State:
    """Residual forces of the free degrees of freedom, the magnitude of the external forces, and tractions at
    points.
    """

    residual: Array
    scale: float
    traction: Traction


@dataclass(frozen=True)
class _Step:
    """One motion of the part."""

    contact: Contact
    before: Array
    part: Posed
    part_before: Posed

    @property
    def kept(self) -> list[int]:
        return [0, 2] if self.contact.layer.axial else [0, 1, 2]

    @property
    def weighted(self) -> csr_matrix:
        layer = self.contact.layer
        return layer.at_points.T.multiply(layer.point_areas).tocsr()

    def at(self, u: Array) -> _State:
        layer = self.contact.layer
        inner = layer.forces(u)
        found = self.contact.forces(self.contact.places(u), self.before, self.part, self.part_before)
        outer = self.weighted @ found.stresses[:, self.kept]
        np.subtract.at(inner, layer.surface_dofs.ravel(), outer.ravel())
        return _State(inner[layer.free], float(np.linalg.norm(outer)) + 1e-9, found)

    def matrix(self, u: Array, traction: Traction) -> csr_matrix:
        """Derivative of the residual; the contact's part couples nodes through the contact points between
        them.
        """
        layer = self.contact.layer
        ends, weighted = layer.surface_dofs, self.weighted
        slopes = traction.slopes[:, self.kept][:, :, self.kept]
        rows, columns, values = [], [], []
        for i, j in np.ndindex(slopes.shape[1:]):
            block = (weighted.multiply(slopes[:, i, j]) @ layer.at_points).tocoo()
            rows.append(ends[block.row, i])
            columns.append(ends[block.col, j])
            values.append(block.data)
        places = np.concatenate(rows), np.concatenate(columns)
        whole = layer.stiffness(u) - csr_matrix((np.concatenate(values), places), shape=(layer.count,) * 2)
        return whole[layer.free][:, layer.free].tocsr()

    def search(self, u: Array, change: Array, now: _State) -> tuple[Array, _State]:
        """Line search: the first fraction of a step with sufficient decrease of the residual, or the best one
        tried.
        """
        size, free = float(np.linalg.norm(now.residual)), self.contact.layer.free
        work = abs(float(now.residual @ change[free]))
        # Large steps at first contact overshoot.
        share = min(1.0, 0.5 / float(np.abs(change).max()))
        best: tuple[float, Array, _State] | None = None
        for _ in range(6):
            tried = u + share * change
            try:
                found = self.at(tried)
            except NotConverged:
                share *= 0.5
                continue
            off = float(np.linalg.norm(found.residual)) / size
            if off < 1 - 0.1 * share or (abs(float(found.residual @ change[free])) < 0.3 * work and off < 2):
                return tried, found
            if best is None or off < best[0]:
                best = off, tried, found
            share *= 0.5
        if best is None:
            raise NotConverged
        return best[1:]


def graded(fine_mm: float, fine_until_mm: float, until_mm: float, growth: float = 1.25) -> Array:
    """Coordinates from 0 with steps of `fine_mm` that increase further out."""
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
    """A disc of gel for axisymmetric contacts."""
    r = graded(fine_mm, contact_mm, half_mm, 1.15)
    z = heights(fine_mm, thickness_mm, 1.15)
    return Layer(skfem.MeshQuad.init_tensor(r, z), thickness_mm, poisson_ratio)


def block(
    thickness_mm: float, poisson_ratio: float, half_mm: float, fine_mm: float, contact_mm: tuple[float, float]
) -> Layer:
    """A square block of gel."""
    axes = [graded(fine_mm, reach, half_mm, 1.5) for reach in contact_mm]
    x, y = (np.concatenate((-a[:0:-1], a)) for a in axes)
    z = heights(fine_mm, thickness_mm)
    return Layer(skfem.MeshHex.init_tensor(x, y, z), thickness_mm, poisson_ratio)
