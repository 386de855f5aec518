"""Posterior sampling of a part's pose: all poses that explain a contact, instead of one with its covariance.

The height and the tilts of a flat face are determined to micrometres. Its position across the markers and its
rotation in their plane are determined only by its edges, which are observed through the markers that they
separate. The likelihood therefore has several peaks, and plateaus as wide as the marker pitch. These two
motions are sampled. For every sample, a narrow prior holds the pose there while the other directions are
registered again; the sample's weight is its likelihood. This is population Monte Carlo (Cappé et al. 2004)
with the proposals of all rounds as one mixture (Cornuet et al. 2012).

The likelihood assumes that the gel's model errors are independent between markers. Beside an edge they are
not: all markers of a row along the edge have the same error. A shift and a rotation of the part that bring
its next face onto the row explain all of them with two parameters. Markers at the same distance from an edge
therefore count as one: log likelihoods are divided by their number (a power posterior; Bissiri et al. 2016).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.experiments.insertion.belief import Belief
from gelstereo_bench.experiments.insertion.chance import Prior, adjoint, object_covariance
from gelstereo_bench.experiments.insertion.sense import Found

__all__ = ["InPlane", "believed"]

Array = npt.NDArray[np.float64]
#: Registers from a guess (4, 4) with a prior of the given width, mm.
Held: TypeAlias = Callable[[Array, float], Found | None]

#: Length that converts in-plane rotation to translation, mm: the distance of the hole from the hand.
_RADIUS_MM = 15.0
#: Samples that search for other peaks: their number, their distance, and the width of their prior, mm.
_SEARCH_MM, _LOOSE_MM = np.repeat([0.06, 0.12, 0.25, 1.0], 6), 0.05
#: Number of rounds, samples per round, widths of the proposal kernels, and width of the samples' prior, mm.
_ROUNDS, _DRAWS, _WIDTHS_MM, _TIGHT_MM = 3, 40, (0.02, 0.06, 0.2, 0.8), 0.01
#: Standard deviation about a sampled pose, mm.
_KNOWN_MM = 1e-3
#: Prior of a look after earlier ones: 100 times less information than any `Prior` in use.
_VAGUE = Prior(rotation_rad=3.0, shift_mm=20.0)
#: Poses closer than this are one, mm; poses with a log likelihood below the best by more than this are
#: dropped.
_SAME_MM, _MAX_LOG_LOSS = 0.05, 8.0
#: Minimum effective sample size; below it, likelihoods are tempered.
_MIN_EFFECTIVE = 12.0


@dataclass(frozen=True)
class InPlane:
    """The two motions that the heights of a face do not determine: of the part's axis, across it and rotating
    in the plane.

    The directions determined by heights are kept along the motion; a curved part rolls.
    """

    base: Array
    #: (6, 2) motions (ω, v) about the axis's point under the patch, sensor axes, per mm; and (2, 6) the
    #: inverse map.
    ways: Array
    reads: Array
    middle: Array

    @classmethod
    def of(cls, found: Found, from_heights: Array | None = None) -> InPlane:
        """In-plane motions about an estimated pose. `from_heights` is the information from heights, (6, 6);
        by default the pose's information.
        """
        axis, normal = found.t_sensor_object[:3, 2], np.array([0.0, 0.0, 1.0])
        origin, middle = found.t_sensor_object[:3, 3], np.eye(4)
        middle[:3, 3] = origin + np.dot(found.centre_mm - origin, axis) * axis
        across = np.cross(normal, axis)
        reads = np.zeros((2, 6))
        reads[0, 3:] = across / np.linalg.norm(across)
        reads[1, :3] = _RADIUS_MM * normal
        carry = adjoint(middle)
        # Of all motions with the given displacement, the likeliest by the heights; where these are
        # uninformative, the shortest.
        short = np.diag(np.repeat([_RADIUS_MM**2, 1.0], 3))
        across_all = np.linalg.solve(
            carry.T @ (found.information if from_heights is None else from_heights) @ carry + short, reads.T
        )
        ways = across_all @ np.linalg.inv(reads @ across_all)
        return cls(found.t_sensor_object, ways, reads, middle)

    def pose(self, x_mm: Array) -> Array:
        """Pose after a displacement, (2,) mm; (4, 4)."""
        moved = self.middle @ np.asarray(se3_exp(self.ways @ x_mm))
        return np.asarray(moved @ np.linalg.inv(self.middle) @ self.base)

    def along(self, pose: Array) -> Array:
        """Displacement of a pose, (2,) mm."""
        back = np.linalg.inv(self.middle)
        motion = np.asarray(se3_log(back @ pose @ np.linalg.inv(self.base) @ self.middle))
        return np.asarray(self.reads @ motion)

    def known(self) -> Array:
        """Information that determines both motions, (6, 6), sensor frame."""
        reads = self.reads @ np.linalg.inv(adjoint(self.middle))
        return np.asarray(reads.T @ reads / _KNOWN_MM**2)

    def unsure_mm(self, covariance: Array) -> float:
        """Largest standard deviation of both motions for a covariance of the part in its own
        frame, (6, 6).
        """
        carry = adjoint(np.asarray(np.linalg.inv(self.middle) @ self.base))
        there = self.reads @ carry @ covariance @ carry.T @ self.reads.T
        return float(np.sqrt(np.max(np.diag(there))))


def believed(
    tried: Sequence[Found],
    held: Held,
    prior: Prior,
    seed: int,
    from_heights: Array | None = None,
    alike: float = 1.0,
    before: Belief | None = None,
) -> Belief:
    """Belief about a part after some registrations, the best first.

    If the best registration determines both motions, and no other pose explains the contact, the belief is
    that pose with its covariance. `from_heights` is the information from heights about the best pose, (6, 6)
    in the sensor's frame; by default its information. `alike` is the number of markers at the same distance
    from an edge, which count as one. `before` is the belief of earlier looks, in this look's frame; it is
    fused with this look's result.
    """
    best, random = tried[0], np.random.default_rng([seed, 61])
    plane = InPlane.of(best, from_heights)
    away_mm = _SEARCH_MM[:, None] * random.normal(size=(len(_SEARCH_MM), 2))
    scouts = [held(plane.pose(x), _LOOSE_MM) for x in away_mm]
    every = sorted([*tried, *(s for s in scouts if s is not None)], key=lambda f: -f.log_likelihood)
    likely = [f for f in every if f.log_likelihood > every[0].log_likelihood - alike * _MAX_LOG_LOSS]
    peaks = np.array([plane.along(f.t_sensor_object) for f in likely])
    # Earlier looks include the prior.
    prior = prior if before is None else _VAGUE
    alone = Belief.normal(every[0], prior)
    if max(np.ptp(peaks, axis=0).max(), plane.unsure_mm(alone.covariance)) < _SAME_MM:
        return _after(before, [alone.t_sensor_object], np.ones(1), alone.spread)
    spread = object_covariance(every[0], prior, plane.known())
    poses, weights = _sampled(plane, held, peaks, alike, random, _Earlier(before, spread))
    if not poses:
        return _after(before, [alone.t_sensor_object], np.ones(1), alone.spread)
    return _after(before, poses, weights, spread)


def _after(before: Belief | None, poses: Sequence[Array], weights: Array, spread: Array) -> Belief:
    return Belief.of(poses, weights, spread) if before is None else before.fused(poses, weights, spread)


@dataclass(frozen=True)
class _Earlier:
    """Belief of earlier looks, evaluated at poses with a covariance `spread` about them."""

    belief: Belief | None
    spread: Array

    def logs(self, poses: Sequence[Array]) -> Array:
        """Log density up to a constant, (N,)."""
        if self.belief is None:
            return np.zeros(len(poses))
        return np.asarray(np.logaddexp.reduce(self.belief.log_pairs(poses, self.spread), axis=1))

    def centres(self, plane: InPlane, random: np.random.Generator) -> Array:
        """Draw the first in-plane samples, (N, 2) mm."""
        if self.belief is None:
            return np.empty((0, 2))
        base = self.belief.t_sensor_object
        poses = [base @ np.asarray(se3_exp(motion)) for motion in self.belief.draw(random, _DRAWS)]
        return np.array([plane.along(pose) for pose in poses])


def _sampled(
    plane: InPlane,
    held: Held,
    peaks: Array,
    alike: float,
    random: np.random.Generator,
    earlier: _Earlier,
) -> tuple[list[Array], Array]:
    """Poses (4, 4) and weights (N,). First proposals are kernels about `peaks`; `alike` markers
    count as one.
    """
    centres = np.vstack([peaks, earlier.centres(plane, random)])
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
        proposed = np.log(np.mean([_density(x, *one) for one in rounds], axis=0))
        every = logs / alike + earlier.logs(poses)
        weighed = _tempered(every, proposed)
        # The next round's proposals are wider than the present estimate.
        centres, weights = x, _tempered(0.5 * every, proposed)
    return poses, weighed


def _density(x: Array, centres: Array, weights: Array) -> Array:
    squared = np.sum((x[:, None] - centres[None]) ** 2, axis=-1)
    kernels = [np.exp(-0.5 * squared / w**2) / (2.0 * np.pi * w**2) for w in _WIDTHS_MM]
    return np.asarray(np.mean(kernels, axis=0) @ weights)


def _tempered(logs: Array, proposed: Array) -> Array:
    """Importance weights; likelihoods are tempered until the effective sample size is `_MIN_EFFECTIVE`."""
    heat = 1.0
    while True:
        raw = (logs - logs.max()) / heat - proposed
        weights = np.exp(raw - raw.max())
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= _MIN_EFFECTIVE or heat > 100.0:
            return np.asarray(weights)
        heat *= 1.3
