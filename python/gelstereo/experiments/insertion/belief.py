"""What a robot believes of a part's pose: not one pose and its covariance, but all that explain the contact as well.

A flat face tells its height and its tilts to micrometres. Where it lies across the markers, and how it is turned among
them, only its edges tell, and an edge is seen by which markers it passes: the likelihood has plateaus as wide as the
markers stand apart, and several peaks. So these two motions are sampled. Every drawn pose is held there by a narrow
prior while the rest is registered again, and counts by its likelihood. This is population Monte Carlo (Cappé et al.
2004) with all rounds' proposals as one mixture (Cornuet et al. 2012).

The likelihood takes what it does not know of the gel for independent from marker to marker. Beside an edge it is not:
where a row of markers runs along it, all of them hang alike, and a part that is shifted and turned until its next face
meets the row explains them all at once, by two numbers. Markers that lie alike to an edge count as one: logarithms are
divided by how many they are (a power posterior; Bissiri et al. 2016).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo.experiments.insertion.chance import Prior, adjoint, object_covariance
from gelstereo.experiments.insertion.sense import Found
from gelstereo.geometry import se3_exp, se3_log

__all__ = ["Belief", "InPlane", "believed", "drawn"]

Array = npt.NDArray[np.float64]
#: Registers from a guess (4, 4) that is held by a prior of so many mm.
Held: TypeAlias = Callable[[Array, float], Found | None]

#: Length that makes a turn among the markers comparable to a shift across them, mm: the hole is so far from the hand.
_RADIUS_MM = 15.0
#: Draws that look for other peaks, so many this far off, and how loosely they are held, mm.
_SCOUTS_MM, _LOOSE_MM = np.repeat([0.06, 0.12, 0.25, 1.0], 6), 0.05
#: Rounds of draws, draws of each, widths of the kernels they come from, and how tightly they are held, mm.
_ROUNDS, _DRAWS, _WIDTHS_MM, _TIGHT_MM = 3, 40, (0.02, 0.06, 0.2, 0.8), 0.01
#: How well a drawn pose is itself, mm.
_KNOWN_MM = 1e-3
#: Poses within this are one, mm; and one whose likelihood is less by this, in logarithms, does not count.
_SAME_MM, _HOPELESS = 0.05, 8.0
#: With fewer draws than this that count, likelihoods are tempered until as many do.
_LEAST_EFFECTIVE = 12.0


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
        covariance = object_covariance(found, prior)
        return cls(found.t_sensor_object, np.zeros((1, 6)), np.ones(1), covariance)

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


@dataclass(frozen=True)
class InPlane:
    """The two motions that a face does not tell by its heights: of the part's axis, across it and among the markers.

    What the heights tell is kept along the way: a curved part rolls.
    """

    base: Array
    #: (6, 2) motions (ω, v) about the axis's point under the patch, sensor axes, by mm; and (2, 6) how far one goes.
    ways: Array
    reads: Array
    middle: Array

    @classmethod
    def of(cls, found: Found, told: Array | None = None) -> InPlane:
        """Take them about a pose that was found; `told` is what heights tell of it, (6, 6), or else its information."""
        axis, normal = found.t_sensor_object[:3, 2], np.array([0.0, 0.0, 1.0])
        origin, middle = found.t_sensor_object[:3, 3], np.eye(4)
        middle[:3, 3] = origin + np.dot(found.centre_mm - origin, axis) * axis
        across = np.cross(normal, axis)
        reads = np.zeros((2, 6))
        reads[0, 3:] = across / np.linalg.norm(across)
        reads[1, :3] = _RADIUS_MM * normal
        carry = adjoint(middle)
        # A motion is the likeliest of those that go as far: the heights and, where these tell nothing, the shortest.
        short = np.diag(np.repeat([_RADIUS_MM**2, 1.0], 3))
        across_all = np.linalg.solve(
            carry.T @ (found.information if told is None else told) @ carry + short, reads.T
        )
        ways = across_all @ np.linalg.inv(reads @ across_all)
        return cls(found.t_sensor_object, ways, reads, middle)

    def pose(self, x_mm: Array) -> Array:
        """Go so far, (2,) mm; (4, 4)."""
        moved = self.middle @ np.asarray(se3_exp(self.ways @ x_mm))
        return np.asarray(moved @ np.linalg.inv(self.middle) @ self.base)

    def along(self, pose: Array) -> Array:
        """How far a pose is, (2,) mm."""
        back = np.linalg.inv(self.middle)
        motion = np.asarray(se3_log(back @ pose @ np.linalg.inv(self.base) @ self.middle))
        return np.asarray(self.reads @ motion)

    def known(self) -> Array:
        """Information of one who knows both, (6, 6), sensor frame."""
        reads = self.reads @ np.linalg.inv(adjoint(self.middle))
        return np.asarray(reads.T @ reads / _KNOWN_MM**2)

    def unsure_mm(self, covariance: Array) -> float:
        """Greatest standard deviation of them under a covariance of the part in its own frame, (6, 6)."""
        carry = adjoint(np.asarray(np.linalg.inv(self.middle) @ self.base))
        there = self.reads @ carry @ covariance @ carry.T @ self.reads.T
        return float(np.sqrt(np.max(np.diag(there))))


def believed(
    tried: Sequence[Found],
    held: Held,
    prior: Prior,
    seed: int,
    told: Array | None = None,
    alike: float = 1.0,
) -> Belief:
    """What to believe of a part after some registrations, the best first.

    Where that knows both motions, and no other pose explains the contact, it is the best one with its covariance.
    `told` is what heights tell of the best one, (6, 6) in the sensor's frame: its information, unless given. So many
    markers as are `alike` to the part's edges count as one.
    """
    best, random = tried[0], np.random.default_rng([seed, 61])
    plane = InPlane.of(best, told)
    away_mm = _SCOUTS_MM[:, None] * random.normal(size=(len(_SCOUTS_MM), 2))
    scouts = [held(plane.pose(x), _LOOSE_MM) for x in away_mm]
    every = sorted([*tried, *(s for s in scouts if s is not None)], key=lambda f: -f.log_likelihood)
    likely = [f for f in every if f.log_likelihood > every[0].log_likelihood - alike * _HOPELESS]
    peaks = np.array([plane.along(f.t_sensor_object) for f in likely])
    alone = Belief.normal(every[0], prior)
    if max(np.ptp(peaks, axis=0).max(), plane.unsure_mm(alone.covariance)) < _SAME_MM:
        return alone
    poses, weights = _sampled(plane, held, peaks, alike, random)
    if len(poses) == 0:
        return alone
    return _belief(every[0], poses, weights, object_covariance(every[0], prior, plane.known()))


def drawn(beliefs: Sequence[Belief], random: np.random.Generator, count: int) -> Array:
    """Draw means of one motion from each, (count, 6)."""
    return np.asarray(np.mean([belief.draw(random, count) for belief in beliefs], axis=0))


def _sampled(
    plane: InPlane, held: Held, centres: Array, alike: float, random: np.random.Generator
) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and weights (N,), from kernels about `centres` at first; of markers `alike` are one."""
    weights, rounds = np.ones(len(centres)), []
    x, logs, poses, weighed = np.empty((0, 2)), np.empty(0), [], np.empty(0)
    for _ in range(_ROUNDS):
        rounds.append((centres, weights / weights.sum()))
        of = random.choice(len(centres), size=_DRAWS, p=rounds[-1][1])
        widths = random.choice(_WIDTHS_MM, size=_DRAWS)
        for here in centres[of] + widths[:, None] * random.normal(size=(_DRAWS, 2)):
            found = held(plane.pose(here), _TIGHT_MM)
            if found is not None:
                x, logs = np.vstack([x, here]), np.append(logs, found.log_likelihood)
                poses.append(found.t_sensor_object)
        if not poses:
            break
        proposed = np.mean([_density(x, *one) for one in rounds], axis=0)
        weighed = _tempered(logs / alike, np.log(proposed))
        # The next round looks wider than what is believed so far.
        centres, weights = x, _tempered(0.5 * logs / alike, np.log(proposed))
    return np.array(poses), weighed


def _density(x: Array, centres: Array, weights: Array) -> Array:
    squared = np.sum((x[:, None] - centres[None]) ** 2, axis=-1)
    kernels = [np.exp(-0.5 * squared / w**2) / (2.0 * np.pi * w**2) for w in _WIDTHS_MM]
    return np.asarray(np.mean(kernels, axis=0) @ weights)


def _tempered(logs: Array, proposed: Array) -> Array:
    """Importance weights; likelihoods are tempered until `_LEAST_EFFECTIVE` draws count."""
    heat = 1.0
    while True:
        raw = (logs - logs.max()) / heat - proposed
        weights = np.exp(raw - raw.max())
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= _LEAST_EFFECTIVE or heat > 100.0:
            return np.asarray(weights)
        heat *= 1.3


def _belief(best: Found, poses: Array, weights: Array, spread: Array) -> Belief:
    back = np.linalg.inv(best.t_sensor_object)
    motions = np.array([np.asarray(se3_log(back @ pose)) for pose in poses])
    mean = weights @ motions
    t_sensor_object = np.asarray(best.t_sensor_object @ np.asarray(se3_exp(mean)))
    back = np.linalg.inv(t_sensor_object)
    motions = np.array([np.asarray(se3_log(back @ pose)) for pose in poses])
    return Belief(t_sensor_object, motions, weights, spread)
