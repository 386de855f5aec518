"""Finite elements of an elastic layer under a load on a disc, round the axis in one Fourier mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import skfem
from scipy.sparse import coo_matrix
from skfem.helpers import grad

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Disc:
    """A bonded layer of thickness 1 and modulus 1, and the disc on it that carries a uniform load of 1."""

    poisson_ratio: float
    radius: float
    reach: float = 12.0

    def mesh(self, elements: int) -> skfem.MeshQuad:
        """Elements that are finest at the disc's rim and at the surface, and end far out."""
        grow = np.geomspace(1.0, 400.0, 3 * elements) - 1.0
        outside = self.radius + (self.reach - self.radius) * grow / grow[-1]
        inside = self.radius * (1.0 - np.linspace(0.0, 1.0, 2 * elements + 1) ** 2)
        r = np.unique(np.concatenate((inside, outside)))
        z = 1.0 - np.linspace(0.0, 1.0, 2 * elements + 1) ** 2
        return skfem.MeshQuad.init_tensor(r, np.unique(z))

    def motion(self, mode: int, elements: int = 8) -> tuple[Array, Array]:
        """Solve for a pressure (mode 0) or a traction along x (mode 1).

        Returns distances from the axis and, there, the motion along r, about the axis and along z on the
        surface: the amplitudes of cos, -sin and cos of mode times the angle.
        """
        nu = self.poisson_ratio
        lame, shear = nu / ((1 + nu) * (1 - 2 * nu)), 0.5 / (1 + nu)
        mesh = self.mesh(elements)
        element = skfem.ElementVector(skfem.ElementQuad2(), 3)
        basis = skfem.Basis(mesh, element, intorder=5)

        def strain(u: skfem.DiscreteField, r: Array) -> list[Array]:
            """Amplitudes of rr, tt, zz (cos), rt, tz (sin) and rz (cos); the shears doubled."""
            d, value = grad(u), np.asarray(u)
            about = value[0] - mode * value[1]
            return [
                d[0, 0],
                about / r,
                d[2, 1],
                (value[1] - mode * value[0]) / r - d[1, 0],
                -d[1, 1] - mode * value[2] / r,
                d[0, 1] + d[2, 0],
            ]

        # Every basis function's strain at every quadrature point; element matrices are sums over them.
        r = np.asarray(basis.global_coordinates())[0]
        strains = np.stack([np.stack(strain(functions[0], r)) for functions in basis.basis])
        law = np.diag([2 * shear] * 3 + [shear] * 3)
        law[:3, :3] += lame
        weighted = np.einsum("ab,jbeq,eq->jaeq", law, strains, basis.dx * r)
        blocks = np.einsum("iaeq,jaeq->ije", strains, weighted)
        dofs = basis.element_dofs
        ends = [np.broadcast_to(d, blocks.shape).ravel() for d in (dofs[:, None], dofs[None])]
        stiffness = coo_matrix((blocks.ravel(), ends), shape=(basis.N, basis.N)).tocsr()

        top = skfem.FacetBasis(
            mesh, element, facets=mesh.facets_satisfying(lambda x: x[1] > 1 - 1e-9), intorder=5
        )

        @skfem.LinearForm
        def load(v: skfem.DiscreteField, w: skfem.FormExtraParams) -> Array:
            r = w.x[0]
            along = -v[2] if mode == 0 else v[0] + v[1]
            return np.where(r < self.radius, along, 0.0) * r

        def nodes(where: Callable[[Array], Array]) -> Array:
            return basis.get_dofs(where).all().reshape(-1)

        held = nodes(lambda x: (x[1] < 1e-9) | (x[0] > self.reach - 1e-9))
        about = basis.split_indices()[1] if mode == 0 else held
        # On the axis nothing goes outwards in mode 0, and nothing up in mode 1.
        axis = np.intersect1d(nodes(lambda x: x[0] < 1e-9), basis.split_indices()[0 if mode == 0 else 2])
        fixed = np.unique(np.concatenate((held, about, axis)))
        solved = skfem.solve(*skfem.condense(stiffness, load.assemble(top), D=fixed))
        on_top = np.flatnonzero((mesh.p[1] > 1 - 1e-9) & (mesh.p[0] > 0))
        on_top = on_top[np.argsort(mesh.p[0, on_top])]
        return mesh.p[0, on_top], solved[basis.nodal_dofs[:, on_top]]
