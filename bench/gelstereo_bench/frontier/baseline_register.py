"""Registration in plain NumPy and SciPy: the paper's FilterReg and its comparison, RANSAC + ICP.

As in the core, the patch (source) is fitted to the template (target), and the result maps template to sensor.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

with needs(__name__):
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

__all__ = ["filterreg", "icp", "ransac_icp", "rigid_fit"]

Array = npt.NDArray[np.float64]

#: Number of template points with Gaussian weights; with the spacing and widths used here, other weights are
#: below 1e-3.
_NEIGHBOURS = 24


def rigid_fit(source: Array, target: Array, weights: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) that bring source (N, 3) to target (N, 3) (Kabsch, never a
    reflection).
    """
    share = weights / weights.sum()
    source_centre, target_centre = share @ source, share @ target
    u, _, vt = np.linalg.svd((source - source_centre).T @ (share[:, None] * (target - target_centre)))
    sign = np.sign(np.linalg.det(vt.T @ u.T))
    rotation = vt.T @ np.diag([1.0, 1.0, sign]) @ u.T
    return rotation, target_centre - rotation @ source_centre


def _plane_step(points: Array, target: Array, normals: Array, weights: Array) -> tuple[Array, Array]:
    """One damped Gauss-Newton step on distances along normals: rotation and translation."""
    centre = points.mean(axis=0)
    jacobian = np.column_stack([np.cross(points - centre, normals), normals])
    residual = np.einsum("ij,ij->i", points - target, normals)
    information = jacobian.T @ (weights[:, None] * jacobian)
    damping = 1e-6 * np.trace(information) / 6.0
    twist = -np.linalg.solve(information + damping * np.eye(6), jacobian.T @ (weights * residual))
    rotation = Rotation.from_rotvec(twist[:3]).as_matrix()
    return rotation, centre + twist[3:] - rotation @ centre


def _pose(rotation: Array, translation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def _inverse(pose: Array) -> Array:
    return np.asarray(np.linalg.inv(pose), np.float64)


def _apply(pose: Array, points: Array) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3], np.float64)


def filterreg(
    points_mm: Array,
    template_mm: Array,
    normals: Array,
    guess: Array,
    *,
    spacing_mm: float,
    sigma_start_mm: float,
    sigma_floor_mm: float,
    outlier_share: float,
    max_iterations: int,
    step_tolerance: float,
    plane: bool = False,
) -> Array:
    """FilterReg (Gao and Tedrake 2019): t_sensor_object (4, 4) from a guess; point to point or point to
    plane.

    Every patch point is matched to the Gaussian-weighted mean of nearby template points, weighted by its
    inlier probability. The width follows the residuals down to its minimum.
    """
    tree = cKDTree(template_mm)
    t_object_sensor = _inverse(guess)
    sigma = sigma_start_mm
    neighbours = min(_NEIGHBOURS, len(template_mm))
    for _ in range(max_iterations):
        moved = _apply(t_object_sensor, points_mm)
        distance, index = tree.query(moved, k=neighbours)
        nearest = distance[:, :1]
        gauss = np.exp(
            (nearest**2 - distance**2) / (2.0 * sigma**2)
        )  # relative to the nearest, to avoid underflow
        total = gauss.sum(axis=1)
        mean = np.einsum("ij,ijk->ik", gauss, template_mm[index]) / total[:, None]
        # On the surface the sum is 2 pi sigma^2 / spacing^2, the density to which the outliers' density is
        # compared.
        on_surface = total * np.exp(-(nearest[:, 0] ** 2) / (2.0 * sigma**2))
        outlier = outlier_share / (1.0 - outlier_share) * 2.0 * np.pi * sigma**2 / spacing_mm**2
        weights = on_surface / (on_surface + outlier)
        if weights.sum() < 1e-9:
            break
        if plane:
            normal = normals[index[:, 0]]
            step = _pose(*_plane_step(moved, mean, normal, weights))
            squared = np.einsum("ij,ij->i", moved - mean, normal) ** 2
            degrees = 1.0
        else:
            step = _pose(*rigid_fit(moved, mean, weights))
            squared = np.sum((moved - mean) ** 2, axis=1)
            degrees = 3.0
        t_object_sensor = step @ t_object_sensor
        variance = float(weights @ squared / weights.sum()) / degrees
        narrower = float(np.clip(np.sqrt(variance), sigma_floor_mm, sigma))
        still = np.abs(_apply(step, moved) - moved).max() < step_tolerance * spacing_mm
        if still and narrower >= 0.999 * sigma:
            break
        sigma = narrower
    return _inverse(t_object_sensor)


def icp(
    points_mm: Array,
    template_mm: Array,
    normals: Array,
    guess: Array,
    *,
    spacing_mm: float,
    max_distance_mm: float,
    max_iterations: int,
    step_tolerance: float,
    plane: bool,
) -> Array:
    """Iterate closest points, point to point or point to plane: t_sensor_object (4, 4) from a guess."""
    tree = cKDTree(template_mm)
    t_object_sensor = _inverse(guess)
    for _ in range(max_iterations):
        moved = _apply(t_object_sensor, points_mm)
        distance, index = tree.query(moved)
        near = distance < max_distance_mm
        if near.sum() < 6:
            break
        source, target, normal = moved[near], template_mm[index[near]], normals[index[near]]
        ones = np.ones(len(source))
        step = _pose(
            *(_plane_step(source, target, normal, ones) if plane else rigid_fit(source, target, ones))
        )
        t_object_sensor = step @ t_object_sensor
        if np.abs(_apply(step, moved) - moved).max() < step_tolerance * spacing_mm:
            break
    return _inverse(t_object_sensor)


def ransac_icp(
    points_mm: Array,
    template_mm: Array,
    normals: Array,
    guess: Array,
    *,
    spacing_mm: float,
    max_distance_mm: float,
    max_iterations: int,
    step_tolerance: float,
    hypotheses: int,
    search_radius_mm: float,
    seed: int,
) -> Array:
    """Random triples of patch and template points, then point-to-point ICP: t_sensor_object (4, 4)."""
    random = np.random.default_rng(seed)
    tree = cKDTree(template_mm)
    t_object_guess = _inverse(guess)
    start = _apply(t_object_guess, points_mm)
    centroid = start.mean(axis=0)
    best, best_inliers = np.eye(4), int((tree.query(start)[0] < max_distance_mm).sum())
    for _ in range(hypotheses):
        source = start[random.choice(len(start), 3, replace=False)]
        target = np.array([_near(tree, point, search_radius_mm, random) for point in source])
        sides = np.linalg.norm(source - np.roll(source, 1, axis=0), axis=1)
        if (
            np.abs(np.linalg.norm(target - np.roll(target, 1, axis=0), axis=1) - sides).max()
            > max_distance_mm
        ):
            continue
        pose = _pose(*rigid_fit(source, target, np.ones(3)))
        if np.linalg.norm(_apply(pose, centroid[None])[0] - centroid) > search_radius_mm:
            continue
        inliers = int((tree.query(_apply(pose, start))[0] < max_distance_mm).sum())
        if inliers > best_inliers:
            best, best_inliers = pose, inliers
    return icp(
        points_mm,
        template_mm,
        normals,
        _inverse(best @ t_object_guess),
        spacing_mm=spacing_mm,
        max_distance_mm=max_distance_mm,
        max_iterations=max_iterations,
        step_tolerance=step_tolerance,
        plane=False,
    )


def _near(tree: cKDTree, point: Array, radius_mm: float, random: np.random.Generator) -> Array:
    """Draw a template point within the radius, or take the nearest."""
    indices = tree.query_ball_point(point, radius_mm)
    index = indices[random.integers(len(indices))] if indices else int(tree.query(point)[1])
    return np.asarray(tree.data[index], np.float64)
