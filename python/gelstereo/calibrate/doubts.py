"""Plausibility tests of a calibration of layers.

The distribution of every test statistic under the model is known, so each limit follows from the accepted
rate of false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

from .bundle import Solution
from .layers_model import Model
from .print_error import place_errors

__all__ = ["Doubt", "Kind", "doubts_of"]

Array = npt.NDArray[np.float64]
Kind = Literal["pitch", "prior", "misfit", "print"]

#: Rate of false alarms under the model, over all tests together.
RATE = 1e-3


@dataclass(frozen=True)
class Doubt:
    """A reason not to believe a calibration.

    Attributes
    ----------
    kind
        ``"pitch"``: the estimated pitch contradicts the stated one. ``"prior"``: another estimate contradicts
        its prior. ``"misfit"``: residuals are larger than the noise, or correlated between neighbouring
        markers; the model is then wrong. ``"print"``: markers lie too far from their nominal places in the
        lattice.
    message
        What was found, what is plausible, and what to check.
    """

    kind: Kind
    message: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.message}"


def doubts_of(model: Model, solution: Solution, print_sigma_mm: float) -> tuple[Doubt, ...]:
    """All doubts, in the order of the tests."""
    priors = model.priors()
    # One test for each prior, and four for misfit and print.
    rate = RATE / (len(priors) + 4)
    found = _priors(model, solution, rate) + _misfit(model, solution, rate)
    place = _Places.of(model, solution, print_sigma_mm)
    return tuple(found + place.together(rate) + place.alone(rate) + place.size(rate))


def _priors(model: Model, solution: Solution, rate: float) -> list[Doubt]:
    """Estimates that contradict their priors.

    The distance of an estimate from the prior's mean has the variance by which the frames reduced the prior's
    variance.
    """
    limit = NormalDist().inv_cdf(1.0 - 0.5 * rate)
    found = []
    for place, mean, sigma, name in model.priors():
        off = float(solution.shared[place]) - mean
        narrowed = sigma**2 - float(solution.covariance[place, place])
        if off**2 <= limit**2 * max(narrowed, 0.0) or off**2 < 1e-18:
            continue
        kind: Kind = "pitch" if name == "pitch_mm" else "prior"
        found.append(
            Doubt(
                kind,
                f"{name} is off by {off:+.4f} from what was stated with a tolerance of {sigma:.4f}; chance "
                f"allows {limit * max(narrowed, 0.0) ** 0.5:.4f}",
            )
        )
    return found


def _misfit(model: Model, solution: Solution, rate: float) -> list[Doubt]:
    chi2 = solution.chi2 + model.scatter_chi2
    degrees = solution.degrees_of_freedom + model.scatter_degrees
    limit = chi2_quantile(degrees, 1.0 - rate)
    if chi2 <= limit:
        return []
    times = (chi2 / degrees) ** 0.5
    return [
        Doubt(
            "misfit",
            f"residuals are {times:.2f} times the noise of {model.known.centre_sigma_px} px (chi2 {chi2:.0f} "
            f"of {degrees}; chance allows {limit:.0f}): centres are noisier than that, or the cameras, the "
            "boards or the flat layers are not as the model has them",
        )
    ]


def chi2_quantile(degrees: int, probability: float) -> float:
    """Quantile of the chi-squared distribution (Wilson and Hilferty, 1931)."""
    spread = 2.0 / (9.0 * max(degrees, 1))
    root = max(1.0 - spread + NormalDist().inv_cdf(probability) * float(np.sqrt(spread)), 0.0)
    return degrees * root * root * root


@dataclass(frozen=True)
class _Places:
    """Position errors of the markers at rest, in standard deviations.

    Attributes
    ----------
    places
        (M, 2) column and row.
    errors
        (M, 2) standard normal, if the model holds.
    """

    places: Array
    errors: Array
    pitch_mm: float
    print_sigma_mm: float

    @classmethod
    def of(cls, model: Model, solution: Solution, print_sigma_mm: float) -> _Places:
        errors_mm, variances = place_errors(solution.linearised)
        errors = errors_mm / np.sqrt(variances + print_sigma_mm**2)
        return cls(
            model.places[: len(errors)].astype(int),
            errors,
            float(solution.shared[-1]) * min(1.0, model.known.aspect),
            print_sigma_mm,
        )

    def together(self, rate: float) -> list[Doubt]:
        """Whether errors of neighbours are correlated.

        Products of independent standard normal numbers have mean 0 and variance 1. They are uncorrelated if
        no two products share the same pair.
        """
        at = {(int(c), int(r)): i for i, (c, r) in enumerate(self.places)}
        pairs = [
            (i, at[c + dc, r + dr])
            for (c, r), i in at.items()
            for dc, dr in ((1, 0), (0, 1))
            if (c + dc, r + dr) in at
        ]
        if not pairs:
            return []
        one, other = np.array(pairs).T
        products = (self.errors[one] * self.errors[other]).ravel()
        alike, limit = float(products.mean()), NormalDist().inv_cdf(1.0 - rate) / len(products) ** 0.5
        if alike <= limit:
            return []
        return [
            Doubt(
                "misfit",
                f"places of neighbouring markers are off alike (correlation {alike:.2f}; chance allows "
                f"{limit:.2f}), as errors of a print are not: the lattice is stretched, sheared or not flat, "
                "or the cameras are off",
            )
        ]

    def alone(self, rate: float) -> list[Doubt]:
        """Whether one marker is an outlier: its squared error has two degrees of freedom."""
        squares = (self.errors**2).sum(axis=1)
        limit, worst = 2.0 * float(np.log(len(squares) / rate)), int(squares.argmax())
        if squares[worst] <= limit:
            return []
        col, row = self.places[worst]
        return [
            Doubt(
                "print",
                f"the marker in row {row}, column {col} is {squares[worst] ** 0.5:.1f} standard deviations "
                f"from its place; chance allows {limit**0.5:.1f} (and {int((squares > limit).sum())} in all "
                "are beyond it): it was named or printed wrong, or its centre is hidden; leave it out",
            )
        ]

    def size(self, rate: float) -> list[Doubt]:
        """Whether errors are so large that a marker may lie nearer to another marker's place than
        to its own.
        """
        limit = 0.5 * self.pitch_mm / (2.0 * float(np.log(len(self.errors) / rate))) ** 0.5
        if self.print_sigma_mm <= limit:
            return []
        return [
            Doubt(
                "print",
                f"markers are off by {self.print_sigma_mm:.3f} mm a direction; beyond {limit:.3f} some of a "
                f"lattice of {self.pitch_mm:.3f} mm lie nearer to another's place: rows and columns are "
                "named wrong",
            )
        ]
