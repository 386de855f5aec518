"""What a robot believes of a part's pose: a mixture of normal distributions of one covariance.

Beliefs from two looks at the same part are fused by multiplying their densities. The product of two mixtures is a
mixture over the pairs of their poses. Each pair is fused by its covariances, and counts by how well its poses agree.
Where both beliefs are a single pose, that is the fusion of two normal distributions in information form.
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

#: Poses that a fused belief keeps at most: the likeliest pairs.
_MAX_PAIRS = 400


@dataclass(frozen=True)
class Belief:
    """Poses of a part, with weights; the spread about each of them is normal."""

    #: Their mean: what the robot acts on, (4, 4).
    t_sensor_object: Array
    #: Motions (ω, v) of the part from there, in its own frame, (N, 6), and their weights, (N,), of sum 1.
    motions: Array
    weights: Array
    #: (6, 6) about each of them.
    spread: Array

    @classmethod
    def normal(cls, found: Found, prior: Prior) -> Belief:
        """One pose and its covariance."""
        return cls(found.t_sensor_object, np.zeros((1, 6)), np.ones(1), object_covariance(found, prior))

    @classmethod
    def of(cls, poses: Sequence[Array], weights: Array, spread: Array) -> Belief:
        """Take poses (N, 4, 4) that lie close together."""
        return cls.about(poses[0], _motions(poses[0], poses), weights, spread)

    @classmethod
    def about(cls, pose: Array, motions: Array, weights: Array, spread: Array) -> Belief:
        """Take motions (N, 6) from a pose (4, 4) that need not be their mean."""
        poses = [pose @ np.asarray(se3_exp(motion)) for motion in motions]
        mean = np.asarray(pose @ np.asarray(se3_exp(weights @ motions)))
        return cls(mean, _motions(mean, poses), weights, spread)

    @property
    def covariance(self) -> Array:
        """Of the whole, (6, 6)."""
        return np.asarray((self.motions.T * self.weights) @ self.motions + self.spread)

    def draw(self, random: np.random.Generator, count: int) -> Array:
        """Draw motions from the mean, (count, 6)."""
        of = random.choice(len(self.weights), size=count, p=self.weights)
        values, vectors = np.linalg.eigh(self.spread)
        about = random.normal(size=(count, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(self.motions[of] + about)

    def moved(self, t_new_old: Array, covariance: Array) -> Belief:
        """Belief in another frame of the sensor, (4, 4), after the part moved in its own frame by chance, (6, 6)."""
        pose = np.asarray(t_new_old @ self.t_sensor_object)
        return Belief(pose, self.motions, self.weights, self.spread + covariance)

    def log_pairs(self, poses: Sequence[Array], spread: Array) -> Array:
        """Logarithms of how well every one of other poses (M, 4, 4) agrees with every one of these, (M, N).

        `spread` (6, 6) is about each of the other poses. Summed over these, it is this belief's density there but for a
        constant factor.
        """
        apart = _motions(self.t_sensor_object, poses)[:, None] - self.motions[None]
        squared = np.einsum("mni,ij,mnj->mn", apart, np.linalg.inv(self.spread + spread), apart)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.weights) - 0.5 * squared)

    def fused(self, poses: Sequence[Array], weights: Array, spread: Array) -> Belief:
        """Fuse with poses (M, 4, 4) of another look, whose `weights` (M,) already count this belief's density."""
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
    """Draw means of one motion from each, (count, 6)."""
    return np.asarray(np.mean([belief.draw(random, count) for belief in beliefs], axis=0))


def _motions(base: Array, poses: Sequence[Array]) -> Array:
    back = np.linalg.inv(base)
    return np.array([np.asarray(se3_log(back @ pose)) for pose in poses])


def _normalised_logs(logs: Array) -> Array:
    """Divide each row's numbers, given by their logarithms, by their sum."""
    return np.asarray(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
