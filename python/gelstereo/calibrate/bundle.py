"""Least squares in which each marker has parameters of its own (Triggs et al., "Bundle adjustment", 2000)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
        (M, 4, 2) those by a marker's own parameters, for the markers that have any.
    has_own
        (N,) which these are.
    prior_residual, prior_jacobian
        (K,) and (K, P) of what is known beforehand.
    """

    residual: Array
    jacobian: Array
    own: Array
    has_own: npt.NDArray[np.bool_]
    prior_residual: Array
    prior_jacobian: Array

    def _across(self) -> Array:
        """(M, 4, 2) basis of what a marker's own parameters cannot change."""
        basis: Array = np.linalg.qr(self.own, mode="complete")[0]
        return basis[:, :, 2:]

    def reduced_jacobian(self) -> Array:
        """Rows by the shared parameters, with every marker's own ones eliminated."""
        width = self.jacobian.shape[2]
        free = np.einsum("mij,mip->mjp", self._across(), self.jacobian[self.has_own])
        return np.concatenate([self.jacobian[~self.has_own].reshape(-1, width), free.reshape(-1, width)])

    def marker_residual(self) -> Array:
        """Residuals that belong to `reduced_jacobian`."""
        free = np.einsum("mij,mi->mj", self._across(), self.residual[self.has_own])
        return np.concatenate([self.residual[~self.has_own].ravel(), free.ravel()])

    def whole(self) -> tuple[Array, Array]:
        """Jacobian and residual with the priors."""
        jacobian = np.concatenate([self.reduced_jacobian(), self.prior_jacobian])
        return jacobian, np.concatenate([self.marker_residual(), self.prior_residual])

    def own_step(self, shared_step: Array) -> Array:
        """(M, 2) best change of the markers' own parameters beside a change of the shared ones."""
        left = self.residual[self.has_own] - self.jacobian[self.has_own] @ shared_step
        step: Array = np.einsum("mij,mj->mi", np.linalg.pinv(self.own), left)
        return step


@dataclass(frozen=True)
class Solution:
    """Where the sum of squares is least.

    Attributes
    ----------
    shared
        Shared parameters.
    covariance
        Of these; where the problem has no rank it is 0, which the caller must have ruled out.
    linearised
        The problem there.
    chi2, degrees_of_freedom
        Sum of squares, and what it should be.
    """

    shared: Array
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
        if there is not None and _chi2(there) <= _chi2(at) * (1 + 1e-9):
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
            return _solution(shared, at)
    raise CalibrationError(
        "no layers explain the markers: the search does not come to rest; check the rig, the pitch, the boards' "
        "heights and the layers it starts from"
    )


def _try(linearise: Callable[[Array, Array], Linearised], shared: Array, own: Array) -> Linearised | None:
    """The problem there, or None where the parameters mean nothing (an index below 1, say)."""
    try:
        return linearise(shared, own)
    except ValueError:
        return None


def _chi2(at: Linearised) -> float:
    return float((at.residual**2).sum() + (at.prior_residual**2).sum())


def _solution(shared: Array, at: Linearised) -> Solution:
    jacobian, residual = at.whole()
    scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    inverse = np.linalg.pinv(jacobian * scale, rcond=1e-12)
    covariance = (inverse @ inverse.T) * np.outer(scale, scale)
    return Solution(shared, covariance, at, float(residual @ residual), len(residual) - len(shared))
