"""Print errors of the markers, by restricted maximum likelihood.

Every marker at rest is displaced from its nominal place by two independent normal errors in the plane of the
print, with one variance for all. The variance maximises the likelihood of the residuals after projecting out
the shared parameters (Patterson and Thompson, "Recovery of inter-block information when block sizes are
unequal", 1971). Plain maximum likelihood would underestimate it, because the shared parameters absorb part of
the errors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from .bundle import Linearised

__all__ = ["place_errors", "print_variance"]

Array = npt.NDArray[np.float64]

#: Steps of the golden section: an interval of 2 in log variance ends a ten-thousandth wide.
SECTIONS = 20
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


def print_variance(at: Linearised, lattice_mm: float) -> float:
    """Restricted maximum-likelihood variance of the own parameters that are not free, mm².

    Parameters
    ----------
    at
        The problem linearised at its solution.
    lattice_mm
        Upper bound of the position errors.
    """
    likelihood = _restricted_likelihood(at)
    # Below this, print errors add at most a millionth to the noise, even of the marker that shows them best.
    min_variance = 1e-6 / float((at.turned[0][~at.is_free] ** 2).max())
    low, high = np.log(min_variance), 2.0 * np.log(lattice_mm)
    grid = np.linspace(low, high, 25)
    best = int(np.argmax([likelihood(float(np.exp(x))) for x in grid]))
    if best == 0:
        return 0.0
    return float(
        np.exp(_highest(likelihood, float(grid[best - 1]), float(grid[min(best + 1, len(grid) - 1)])))
    )


def _highest(likelihood: Callable[[float], float], low: float, high: float) -> float:
    """Maximum of the likelihood between two logarithms of the variance, by golden-section search."""
    inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_inner, at_outer = likelihood(float(np.exp(inner))), likelihood(float(np.exp(outer)))
    for _ in range(SECTIONS):
        if at_inner < at_outer:
            low, inner, at_inner = inner, outer, at_outer
            outer = low + GOLDEN * (high - low)
            at_outer = likelihood(float(np.exp(outer)))
        else:
            high, outer, at_outer = outer, inner, at_inner
            inner = high - GOLDEN * (high - low)
            at_inner = likelihood(float(np.exp(inner)))
    return 0.5 * (low + high)


def _restricted_likelihood(at: Linearised) -> Callable[[float], float]:
    """Log restricted likelihood of a variance, up to a constant."""
    values, residual, jacobian = at.turned
    seen = ~at.is_free
    squares = (values[seen] ** 2).ravel()
    along, by = residual[seen, :2].ravel(), jacobian[seen, :2].reshape(len(squares), -1)
    rest = np.concatenate([residual[:, 2:].ravel(), at.prior_residual])
    rest_by = np.concatenate([jacobian[:, 2:].reshape(-1, by.shape[1]), at.prior_jacobian])
    scale = 1.0 / np.maximum(np.linalg.norm(np.concatenate([rest_by, by]), axis=0), 1e-300)
    by, rest_by = by * scale, rest_by * scale
    normal, right, square = rest_by.T @ rest_by, rest_by.T @ rest, float(rest @ rest)

    def likelihood(variance: float) -> float:
        weight = 1.0 / (1.0 + variance * squares)
        system = normal + (by.T * weight) @ by
        target = right + by.T @ (weight * along)
        left = square + float(weight @ along**2) - float(target @ np.linalg.solve(system, target))
        return -0.5 * (left + float(np.linalg.slogdet(system)[1]) - float(np.log(weight).sum()))

    return likelihood


def place_errors(at: Linearised) -> tuple[Array, Array]:
    """Individual position errors of the markers, and their variances from the centres' noise.

    Returns
    -------
    errors : (M, 2), mm
        Errors of the markers whose own parameters are not free, in the order of the problem.
    variances : (M, 2), mm²
        From noise alone, without the print's variance.
    """
    own, residual = at.own[~at.is_free], at.residual[~at.is_free]
    inverse = np.linalg.pinv(own)
    return np.einsum("mij,mj->mi", inverse, residual), (inverse**2).sum(axis=2)
