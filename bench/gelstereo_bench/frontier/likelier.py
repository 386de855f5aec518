"""Limit of heights alone: poses that explain the sensed heights better than the truth does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from gelstereo import Simulator
from gelstereo_bench.frontier.grasps import SIDE, STRAY_MM, Grasp, Noise, simulator_of

__all__ = ["log_likelihood", "success_or_likelier"]

Array = npt.NDArray[np.float64]


def log_likelihood(grasp: Grasp, noise: Noise, simulator: Simulator, t_sensor_object: Array) -> float:
    """Log likelihood of all heights of a contact at a pose, (4, 4), with the simulator's own contact, noise
    and outliers.
    """
    exact = np.asarray(simulator.press(t_sensor_object).points_mm, np.float64)
    off = grasp.all_points_mm - exact
    # A marker's lateral position has half the noise; its height changes by that times the slope.
    slopes = _slopes(exact.reshape(SIDE, SIDE, 3)).reshape(-1, 2)
    variance = noise.sigma_mm**2 * (1.0 + 0.25 * np.sum(slopes**2, axis=1))
    squared = (off[:, 2] - np.sum(slopes * off[:, :2], axis=1)) ** 2 / variance
    # Limited to the range in which a number differs from 0.
    good = np.exp(-0.5 * np.minimum(squared, 1400.0)) / np.sqrt(2.0 * np.pi * variance)
    salient = (grasp.all_points_mm[:, None] == grasp.points_mm[None]).all(axis=2).any(axis=1)
    stray = np.where(salient, noise.outliers, 0.0)
    return float(np.sum(np.log((1.0 - stray) * good + stray / (2.0 * STRAY_MM))))


def _slopes(lattice_mm: Array) -> Array:
    """Gradient of the height, (rows, cols, 2), from points (rows, cols, 3)."""
    along, across = (np.asarray(np.gradient(lattice_mm, axis=axis)) for axis in (0, 1))
    places = np.stack([along[..., :2], across[..., :2]], axis=-2)
    rises = np.stack([along[..., 2], across[..., 2]], axis=-1)
    return np.asarray(np.linalg.solve(places, rises[..., None])[..., 0])


def success_or_likelier(grasps: Sequence[Grasp], noise: Noise, poses: Sequence[Array | None]) -> float:
    """Per cent of poses, one per contact, that are right or likelier than the truth; no estimator can
    distinguish these.
    """
    simulators: dict[str, Simulator] = {}

    def is_either(grasp: Grasp, pose: Array | None) -> bool:
        if pose is None or grasp.score(pose).success:
            return pose is not None
        if grasp.part not in simulators:
            simulators[grasp.part] = simulator_of(grasp.mesh)
        simulator = simulators[grasp.part]
        truth = log_likelihood(grasp, noise, simulator, grasp.t_sensor_object)
        return log_likelihood(grasp, noise, simulator, pose) > truth

    return 100.0 * float(np.mean([is_either(*one) for one in zip(grasps, poses, strict=True)]))
