"""Which poses of a part explain a contact: not one and its covariance, but all that explain it as well.

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

from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.experiments.insertion.belief import Belief
from gelstereo_bench.experiments.insertion.chance import Prior, adjoint, object_covariance
from gelstereo_bench.experiments.insertion.sense import Found

__all__ = ["InPlane", "believed"]

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
#: Prior of a look that others went before: 100 times less information than any `Prior` in use.
_VAGUE = Prior(rotation_rad=3.0, shift_mm=20.0)
#: Poses within this are one, mm; and one whose likelihood is less by this, in logarithms, does not count.
_SAME_MM, _HOPELESS = 0.05, 8.0
#: With fewer draws than this that count, likelihoods are tempered until as many do.
_MIN_EFFECTIVE = 12.0


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
    def of(cls, found: Found, from_heights: Array | None = None) -> InPlane:
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
            carry.T @ (found.information if from_heights is None else from_heights) @ carry + short, reads.T
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
    from_heights: Array | None = None,
    alike: float = 1.0,
    before: Belief | None = None,
) -> Belief:
    """What to believe of a part after some registrations, the best first.

    Where that knows both motions, and no other pose explains the contact, it is the best one with its covariance.
    `told` is what heights tell of the best one, (6, 6) in the sensor's frame: its information, unless given. So many
    markers as are `alike` to the part's edges count as one. `before` is the belief of earlier looks, in this look's
    frame; it is fused with what this look tells.
    """
    best, random = tried[0], np.random.default_rng([seed, 61])
    plane = InPlane.of(best, from_heights)
    away_mm = _SCOUTS_MM[:, None] * random.normal(size=(len(_SCOUTS_MM), 2))
    scouts = [held(plane.pose(x), _LOOSE_MM) for x in away_mm]
    every = sorted([*tried, *(s for s in scouts if s is not None)], key=lambda f: -f.log_likelihood)
    likely = [f for f in every if f.log_likelihood > every[0].log_likelihood - alike * _HOPELESS]
    peaks = np.array([plane.along(f.t_sensor_object) for f in likely])
    # Earlier looks know what is known before anything is sensed.
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
    """What earlier looks say of poses that have `spread` about them."""

    belief: Belief | None
    spread: Array

    def logs(self, poses: Sequence[Array]) -> Array:
        """Logarithms of the density, but for a constant, (N,)."""
        if self.belief is None:
            return np.zeros(len(poses))
        return np.asarray(np.logaddexp.reduce(self.belief.log_pairs(poses, self.spread), axis=1))

    def centres(self, plane: InPlane, random: np.random.Generator) -> Array:
        """Draw in-plane places to look at first, (N, 2) mm."""
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
    """Poses (4, 4) and their weights (N,), from kernels about `peaks` at first; of markers `alike` are one."""
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
        # The next round looks wider than what is believed so far.
        centres, weights = x, _tempered(0.5 * every, proposed)
    return poses, weighed


def _density(x: Array, centres: Array, weights: Array) -> Array:
    squared = np.sum((x[:, None] - centres[None]) ** 2, axis=-1)
    kernels = [np.exp(-0.5 * squared / w**2) / (2.0 * np.pi * w**2) for w in _WIDTHS_MM]
    return np.asarray(np.mean(kernels, axis=0) @ weights)


def _tempered(logs: Array, proposed: Array) -> Array:
    """Importance weights; likelihoods are tempered until `_MIN_EFFECTIVE` draws count."""
    heat = 1.0
    while True:
        raw = (logs - logs.max()) / heat - proposed
        weights = np.exp(raw - raw.max())
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= _MIN_EFFECTIVE or heat > 100.0:
            return np.asarray(weights)
        heat *= 1.3
