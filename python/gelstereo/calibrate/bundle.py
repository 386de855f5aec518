"""Sparse bundle adjustment with individual parameters for each marker (Triggs et al., "Bundle adjustment",
2000).

A marker's own parameters are eliminated by a singular value decomposition of their Jacobian. With singular
values d and a prior variance v, the residuals have the variance 1 + d² v along the left singular vectors, and
1 across them. Dividing by the standard deviation makes them independent. Parameters without a prior have an
infinite v; the residuals along them drop out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .errors import CalibrationError

__all__ = ["Linearised", "Solution", "minimise"]

Array = npt.NDArray[np.float64]

MAX_STEPS = 60


@dataclass(frozen=True)
class Linearised:
    """A least-squares problem linearised at one point; all values are divided by their noise.

    Attributes
    ----------
    residual
        (N, 4) observed less predicted coordinates of each marker.
    jacobian
        (N, 4, P) derivatives of the prediction with respect to the shared parameters.
    own
        (N, 4, 2) derivatives with respect to the marker's own parameters.
    own_variance
        (N,) prior variance of the own parameters; infinite without a prior.
    prior_residual, prior_jacobian
        (K,) and (K, P) residuals and Jacobian of the priors of the shared parameters.
    """

    residual: Array
    jacobian: Array
    own: Array
    own_variance: Array
    prior_residual: Array
    prior_jacobian: Array

    @property
    def is_free(self) -> npt.NDArray[np.bool_]:
        """(N,) whether the marker's own parameters have no prior."""
        return np.isinf(self.own_variance)

    @cached_property
    def turned(self) -> tuple[Array, Array, Array]:
        """(N, 2) singular values of `own`; residual and Jacobian along its four left singular vectors."""
        left, values, _ = np.linalg.svd(self.own, full_matrices=True)
        across = left.transpose(0, 2, 1)
        return values, np.einsum("mji,mi->mj", across, self.residual), across @ self.jacobian

    def _weights(self) -> Array:
        """(N, 4) one over the standard deviation along each left singular vector; 0 where it is infinite."""
        values = self.turned[0]
        known = np.where(self.is_free, 0.0, self.own_variance)[:, None]
        weights = np.ones(self.residual.shape)
        weights[:, :2] = np.where(self.is_free[:, None], 0.0, (1.0 + known * values**2) ** -0.5)
        return weights

    def reduced_jacobian(self) -> Array:
        """Jacobian of the shared parameters, with the markers' own parameters eliminated."""
        weights = self._weights()
        rows: Array = (self.turned[2] * weights[:, :, None])[weights > 0.0]
        return rows

    def marker_residual(self) -> Array:
        """Residuals that belong to `reduced_jacobian`."""
        weights = self._weights()
        rows: Array = (self.turned[1] * weights)[weights > 0.0]
        return rows

    def whole(self) -> tuple[Array, Array]:
        """Jacobian and residual with the priors."""
        jacobian = np.concatenate([self.reduced_jacobian(), self.prior_jacobian])
        return jacobian, np.concatenate([self.marker_residual(), self.prior_residual])

    def chi2(self) -> float:
        """Sum of squares with the markers' own parameters at their optimum."""
        return float((self.marker_residual() ** 2).sum() + (self.prior_residual**2).sum())

    def covariance(self, times: float = 1.0) -> Array:
        """Covariance of the shared parameters, with the stated noise scaled by a factor; 0 where the problem
        is singular.
        """
        jacobian = np.concatenate([self.reduced_jacobian() / times, self.prior_jacobian])
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        inverse = np.linalg.pinv(jacobian * scale, rcond=1e-12)
        found: Array = (inverse @ inverse.T) * np.outer(scale, scale)
        return found

    def own_step(self, shared_step: Array) -> Array:
        """(M, 2) optimal step of the free markers' own parameters for a given step of the shared ones."""
        left = self.residual[self.is_free] - self.jacobian[self.is_free] @ shared_step
        step: Array = np.einsum("mij,mj->mi", np.linalg.pinv(self.own[self.is_free]), left)
        return step


@dataclass(frozen=True)
class Solution:
    """Minimum of the sum of squares.

    Attributes
    ----------
    shared, own
        Shared parameters, and the own parameters of the free markers.
    covariance
        Covariance of the shared parameters. It is 0 where the problem is singular; callers must exclude that
        case.
    linearised
        The problem linearised at the solution.
    chi2, degrees_of_freedom
        Sum of squared residuals of the markers, and the expected sum of these and the priors' squares.
    """

    shared: Array
    own: Array
    covariance: Array
    linearised: Linearised
    chi2: float
    degrees_of_freedom: int


def minimise(linearise: Callable[[Array, Array], Linearised], start: tuple[Array, Array]) -> Solution:
    """Levenberg-Marquardt method, with columns scaled to unit length.

    Raises
    ------
    CalibrationError
        The iteration does not converge.
    """
    (shared, own), damping = start, 1e-3
    at = linearise(shared, own)
    for _ in range(MAX_STEPS):
        jacobian, residual = at.whole()
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        system = np.concatenate([jacobian * scale, np.sqrt(damping) * np.eye(len(shared))])
        target = np.concatenate([residual, np.zeros(len(shared))])
        step = scale * np.linalg.lstsq(system, target, rcond=None)[0]
        there = _try(linearise, shared + step, own + at.own_step(step))
        # Convergence: the expected change of the sum corresponds to 1e-4 of a standard deviation.
        at_rest = float(np.linalg.norm(jacobian @ step)) < 1e-4
        if there is not None and there.chi2() <= at.chi2() * (1 + 1e-9):
            shared, own, at, damping = (
                shared + step,
                own + at.own_step(step),
                there,
                max(damping * 0.1, 1e-12),
            )
        elif not at_rest:
            damping *= 10.0
            continue
        if at_rest:
            return _solution(shared, own, at)
    raise CalibrationError(
        "no layers explain the markers: the search does not converge; check the rig, the boards' heights, "
        "the initial layers and their priors"
    )


def _try(linearise: Callable[[Array, Array], Linearised], shared: Array, own: Array) -> Linearised | None:
    """The problem linearised there, or None for invalid parameters (for example an index below 1)."""
    try:
        return linearise(shared, own)
    except ValueError:
        return None


def _solution(shared: Array, own: Array, at: Linearised) -> Solution:
    residual = at.marker_residual()
    degrees = len(residual) + len(at.prior_residual) - len(shared)
    return Solution(shared, own, at.covariance(), at, float(residual @ residual), degrees)
