"""Belief about a part's pose: a mixture of normal distributions with a common covariance.

Beliefs from two looks at the same part are fused by multiplying their densities. The product of two mixtures
is a mixture over the pairs of their poses. Each pair is fused by its covariances, and weighted by the
agreement of its poses. For two single poses this is the fusion of two normal distributions in information
form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.experiments.insertion.chance import Prior, object_covariance
from gelstereo_bench.experiments.insertion.sense import Found

__all__ = ["Belief", "drawn"]

Array = npt.NDArray[np.float64]

#: Maximum number of poses in a fused belief; the likeliest pairs are kept.
_MAX_PAIRS = 400


@dataclass(frozen=True)
class Belief:
    """Weighted poses of a part, with a normal distribution about each."""

    #: Mean pose, used for the insertion, (4, 4).
    t_sensor_object: Array
    #: Motions (ω, v) of the part from the mean, in its own frame, (N, 6), and their weights, (N,), with sum
    #: 1.
    motions: Array
    weights: Array
    #: (6, 6) covariance about each pose.
    spread: Array

    @classmethod
    def normal(cls, found: Found, prior: Prior) -> Belief:
        """Belief of one pose and its covariance."""
        return cls(found.t_sensor_object, np.zeros((1, 6)), np.ones(1), object_covariance(found, prior))

    @classmethod
    def of(cls, poses: Sequence[Array], weights: Array, spread: Array) -> Belief:
        """Belief of poses (N, 4, 4) that lie close together."""
        return cls.about(poses[0], _motions(poses[0], poses), weights, spread)

    @classmethod
    def about(cls, pose: Array, motions: Array, weights: Array, spread: Array) -> Belief:
        """Belief of motions (N, 6) from a pose (4, 4) that need not be their mean."""
        poses = [pose @ np.asarray(se3_exp(motion)) for motion in motions]
        mean = np.asarray(pose @ np.asarray(se3_exp(weights @ motions)))
        return cls(mean, _motions(mean, poses), weights, spread)

    @property
    def covariance(self) -> Array:
        """Covariance of the whole mixture, (6, 6)."""
        return np.asarray((self.motions.T * self.weights) @ self.motions + self.spread)

    def draw(self, random: np.random.Generator, count: int) -> Array:
        """Draw motions from the mean, (count, 6)."""
        of = random.choice(len(self.weights), size=count, p=self.weights)
        values, vectors = np.linalg.eigh(self.spread)
        about = random.normal(size=(count, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(self.motions[of] + about)

    def moved(self, t_new_old: Array, covariance: Array) -> Belief:
        """Belief in another sensor frame, (4, 4), after a random motion of the part in its own frame with
        covariance (6, 6).
        """
        pose = np.asarray(t_new_old @ self.t_sensor_object)
        return Belief(pose, self.motions, self.weights, self.spread + covariance)

    def log_pairs(self, poses: Sequence[Array], spread: Array) -> Array:
        """Log agreement of each of other poses (M, 4, 4) with each of these, (M, N).

        `spread` (6, 6) is the covariance about each of the other poses. Summed over these poses, the
        agreement is this belief's density at the other poses up to a constant factor.
        """
        apart = _motions(self.t_sensor_object, poses)[:, None] - self.motions[None]
        squared = np.einsum("mni,ij,mnj->mn", apart, np.linalg.inv(self.spread + spread), apart)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.weights) - 0.5 * squared)

    def fused(self, poses: Sequence[Array], weights: Array, spread: Array) -> Belief:
        """Fuse with poses (M, 4, 4) of another look, whose `weights` (M,) already include this belief's
        density.
        """
        pairs = np.exp(_normalised_logs(self.log_pairs(poses, spread))) * weights[:, None]
        order = np.argsort(pairs, axis=None, kind="stable")[::-1][:_MAX_PAIRS]
        other, mine = np.unravel_index(order, pairs.shape)
        kept = pairs.ravel()[order]
        there = _motions(self.t_sensor_object, poses)
        gain = spread @ np.linalg.inv(self.spread + spread)
        motions = there[other] - (there[other] - self.motions[mine]) @ gain.T
        narrow = spread - gain @ spread
        return Belief.about(self.t_sensor_object, motions, kept / kept.sum(), 0.5 * (narrow + narrow.T))


def drawn(beliefs: Sequence[Belief], random: np.random.Generator, count: int) -> Array:
    """Draw means over one motion from each belief, (count, 6)."""
    return np.asarray(np.mean([belief.draw(random, count) for belief in beliefs], axis=0))


def _motions(base: Array, poses: Sequence[Array]) -> Array:
    back = np.linalg.inv(base)
    return np.array([np.asarray(se3_log(back @ pose)) for pose in poses])


def _normalised_logs(logs: Array) -> Array:
    """Normalise each row of weights, given as logarithms, to sum 1."""
    return np.asarray(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
