"""Least squares in which each marker has parameters of its own (Triggs et al., "Bundle adjustment", 2000).

A marker's own parameters are eliminated by the singular values of its derivatives by them. With singular values d and
a prior variance v, the residuals have the covariance 1 + d² v along the left singular vectors, and 1 across: divided by
its root they are independent again. What is not known beforehand has an infinite v, and drops out.
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
    """A least-squares problem around one point; everything in units of its noise.

    Attributes
    ----------
    residual
        (N, 4) observed less predicted coordinates of each marker.
    jacobian
        (N, 4, P) derivatives of the prediction by the shared parameters.
    own
        (N, 4, 2) those by the marker's own parameters.
    own_variance
        (N,) what these vary by, beforehand: infinite where nothing is known.
    prior_residual, prior_jacobian
        (K,) and (K, P) of what is known beforehand of the shared parameters.
    """

    residual: Array
    jacobian: Array
    own: Array
    own_variance: Array
    prior_residual: Array
    prior_jacobian: Array

    @property
    def is_free(self) -> npt.NDArray[np.bool_]:
        """(N,) where nothing is known of the marker's own parameters."""
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
        """Rows by the shared parameters, with every marker's own ones eliminated."""
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
        """Sum of squares with every marker where it fits best."""
        return float((self.marker_residual() ** 2).sum() + (self.prior_residual**2).sum())

    def covariance(self, times: float = 1.0) -> Array:
        """Of the shared parameters, with so many times the noise that was stated; 0 where there is no rank."""
        jacobian = np.concatenate([self.reduced_jacobian() / times, self.prior_jacobian])
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        inverse = np.linalg.pinv(jacobian * scale, rcond=1e-12)
        found: Array = (inverse @ inverse.T) * np.outer(scale, scale)
        return found

    def own_step(self, shared_step: Array) -> Array:
        """(M, 2) best change of the free markers' own parameters beside a change of the shared ones."""
        left = self.residual[self.is_free] - self.jacobian[self.is_free] @ shared_step
        step: Array = np.einsum("mij,mj->mi", np.linalg.pinv(self.own[self.is_free]), left)
        return step


@dataclass(frozen=True)
class Solution:
    """Where the sum of squares is least.

    Attributes
    ----------
    shared, own
        Shared parameters, and those of the free markers.
    covariance
        Of the shared ones; where the problem has no rank it is 0, which the caller must have ruled out.
    linearised
        The problem there.
    chi2, degrees_of_freedom
        Sum of the markers' squares, and what it and that of the priors should be together.
    """

    shared: Array
    own: Array
    covariance: Array
    linearised: Linearised
    chi2: float
    degrees_of_freedom: int


def minimise(linearise: Callable[[Array, Array], Linearised], start: tuple[Array, Array]) -> Solution:
    """Levenberg's and Marquardt's method, with columns scaled to unit length.

    Raises
    ------
    CalibrationError
        It does not come to rest.
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
        # Expected change of the sum, in units of the noise: 1e-4 of a standard deviation is rest.
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
        "no layers explain the markers: the search does not come to rest; check the rig, the boards' heights, the "
        "layers it starts from and their priors"
    )


def _try(linearise: Callable[[Array, Array], Linearised], shared: Array, own: Array) -> Linearised | None:
    """The problem there, or None where the parameters mean nothing (an index below 1, say)."""
    try:
        return linearise(shared, own)
    except ValueError:
        return None


def _solution(shared: Array, own: Array, at: Linearised) -> Solution:
    residual = at.marker_residual()
    degrees = len(residual) + len(at.prior_residual) - len(shared)
    return Solution(shared, own, at.covariance(), at, float(residual @ residual), degrees)
