"""The surface of an unknown part, grown from its contacts and read back from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo as gs
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.part_surface import PartSurface, RecognitionStatus


def sphere(seed: int, count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sigma = random.uniform(0.002, 0.02, count)
    return (6.0 + sigma * random.normal(size=count))[:, None] * normals, normals, sigma


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), order=st.randoms(use_true_random=False))
def test_points_are_weighted_means_in_any_order(seed: int, order: object) -> None:
    points, normals, sigma = sphere(seed)
    at_once, one_by_one = PartSurface(0.8), PartSurface(0.8)
    at_once.add(points, normals, sigma)
    shuffled = list(range(len(points)))
    order.shuffle(shuffled)  # type: ignore[attr-defined]
    for part in np.array_split(shuffled, 7):
        one_by_one.add(points[part], normals[part], sigma[part])
    np.testing.assert_allclose(one_by_one.points_mm, at_once.points_mm, atol=1e-12)
    np.testing.assert_allclose(one_by_one.sigma_mm, at_once.sigma_mm, rtol=1e-12)
    # Independently: the points of one voxel, one after the other.
    keys = [tuple(key) for key in np.floor(points / 0.8).astype(int)]
    for key, found, spread in zip(sorted({*keys}), at_once.points_mm, at_once.sigma_mm, strict=True):
        inside = [k for k, other in enumerate(keys) if other == key]
        weights = sigma[inside] ** -2
        np.testing.assert_allclose(found, np.average(points[inside], axis=0, weights=weights), atol=1e-12)
        assert spread == pytest.approx(np.sum(weights) ** -0.5)
    np.testing.assert_allclose(np.linalg.norm(at_once.normals, axis=1), 1.0, atol=1e-12)


def test_files_are_read_by_trimesh(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    surface = PartSurface(0.8)
    surface.add(*sphere(1))
    surface.write_ply(tmp_path / "part.ply")
    surface.write_stl(tmp_path / "part.stl")
    cloud = trimesh.load(tmp_path / "part.ply")
    np.testing.assert_allclose(cloud.vertices, surface.points_mm, atol=1e-6)
    template = gs.Template.from_mesh(tmp_path / "part.ply", units="mm")
    np.testing.assert_allclose(template.normals, surface.normals, atol=1e-5)
    mesh = trimesh.load(tmp_path / "part.stl")
    assert len(mesh.faces) == 6 * len(surface)
    # Six triangles of one disc: outward, and of the area of a hexagon.
    facing = np.einsum("ij,ij->i", mesh.face_normals, np.repeat(surface.normals, 6, axis=0))
    np.testing.assert_allclose(facing, 1.0, atol=1e-4)
    assert mesh.area == pytest.approx(len(surface) * 1.5 * np.sqrt(3.0) * (0.75 * 0.8) ** 2, rel=1e-4)


def test_the_surface_of_a_rolled_cylinder_grows() -> None:
    """A third of a turn: the points are on the cylinder, over an arc that no contact shows alone."""
    radius_mm = 4.0
    peg = {"kind": "cylinder", "radius_mm": radius_mm, "length_mm": 30.0}
    simulator = gs.Simulator(gs.Scene().replace(indenter=peg, effects={"elastic_layer": {"friction": 1.5}}))
    random, noise_mm = np.random.default_rng(3), np.array([0.0015, 0.0015, 0.005])
    rest = simulator.advance(None, frame=0).points_mm
    tracker = gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=25)
    covariance = np.tile(np.diag(noise_mm**2), (len(rest), 1, 1))
    pose = np.eye(4)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    pose[:3, 3] = 0.0, 0.0, 40.0
    touch = pose = np.asarray(simulator.pressed(pose, 1.0))
    assert tracker.surface()[0].shape == (0, 3)
    surface, sizes = PartSurface(), []
    for index in range(1, 36):
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        points = frame.points_mm + noise_mm * random.normal(size=rest.shape)
        assert tracker.run(points, covariance, [bool(s) for s in frame.loads.stick]) is not None
        surface.add(*tracker.surface())
        sizes.append(len(surface))
        line = np.eye(4)
        line[:3, 3] = pose[:3, 3] - [0.0, 0.0, radius_mm]
        pose = np.asarray(
            line @ se3_exp(np.array([0.0, 0.06, 0.0, 0.0, 0.0, 0.0])) @ np.linalg.inv(line) @ pose
        )
    local = (surface.points_mm - touch[:3, 3]) @ touch[:3, :3]
    distance = np.hypot(local[:, 0], local[:, 1]) - radius_mm
    assert np.median(np.abs(distance)) < 0.01 and np.percentile(np.abs(distance), 95) < 0.05
    outward = (surface.normals @ touch[:3, :3])[:, :2]
    assert np.median(np.sum(outward * local[:, :2], axis=1) / np.hypot(*local[:, :2].T)) > 0.99
    arc = np.degrees(np.ptp(np.unwrap(np.sort(np.arctan2(local[:, 1], local[:, 0])))))
    assert sizes[-1] > 2 * sizes[0] and arc > 110.0, (sizes, arc)


def contact(simulator: gs.Simulator, start: np.ndarray, seed: int) -> tuple[np.ndarray, PartSurface, tuple]:
    """A part pressed and rocked: its pose at touch, its grown surface, and that of the first frame."""
    random, noise_mm = np.random.default_rng(seed), np.array([0.0015, 0.0015, 0.005])
    rest = simulator.advance(None, frame=0).points_mm
    tracker = gs.MotionTracker(gs.RestSurface(rest), gs.Params(), cols=25)
    covariance = np.tile(np.diag(noise_mm**2), (len(rest), 1, 1))
    touch = pose = np.asarray(simulator.pressed(start, 0.8))
    surface, first = PartSurface(), None
    for index in range(1, 6):
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        points = frame.points_mm + noise_mm * random.normal(size=rest.shape)
        tracker.run(points, covariance, [bool(stick) for stick in frame.loads.stick])
        first = first or tracker.surface()
        surface.add(*tracker.surface())
        rock = np.eye(4)
        rock[:3, 3] = pose[:3, 3]
        pose = np.asarray(rock @ se3_exp(np.array([0.01, 0.01, 0, 0, 0, 0])) @ np.linalg.inv(rock) @ pose)
    assert first is not None
    return touch, surface, first


def test_a_part_that_comes_back_is_recognized() -> None:
    peg = {"kind": "cylinder", "radius_mm": 3.0, "length_mm": 20.0}
    start = np.eye(4)
    start[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    start[:3, 3] = 4.0, 0.0, 40.0
    move = np.eye(4)
    move[:3, 3] = 1.3, -0.4, 0.0
    simulator = gs.Simulator(gs.Scene().replace(indenter=peg, effects={"elastic_layer": {"friction": 2.0}}))
    turned = start @ se3_exp(np.array([0.0, 0.06, 0.0, 0.0, 0.0, 0.0]))
    first, known, _ = contact(simulator, start, 1)
    second, _, seen = contact(simulator, move @ turned, 2)
    truth = second @ np.linalg.inv(first)
    middle = np.eye(4)
    middle[:3, 3] = seen[0].mean(axis=0)
    off = np.array([0.05, -0.04, 0.06, 0.3, 0.2, -0.3])
    guess = middle @ se3_exp(off) @ np.linalg.inv(middle) @ truth
    found = known.recognize(*seen, guess=guess)
    assert found.status == RecognitionStatus.FOUND, found
    # Neither its spin nor its shift along the axis is seen.
    assert found.determined == 4
    to = np.eye(4)
    to[:3, 3] = -found.about_mm
    error = se3_log(to @ truth @ np.linalg.inv(found.t_contact_part) @ np.linalg.inv(to))
    assert error @ np.linalg.solve(found.covariance, error) < 25.0
    # At the axis, which spin and shift leave in place.
    to[:3, 3] = -second[:3, 3]
    axis = se3_log(to @ truth @ np.linalg.inv(found.t_contact_part) @ np.linalg.inv(to))
    assert np.all(np.abs(axis[[0, 2]]) < 0.01) and np.all(np.abs(axis[[3, 5]]) < 0.02), axis
    assert repr(found).startswith("<Recognition: FOUND, ")
    ball = gs.Scene().replace(indenter={"kind": "sphere", "radius_mm": 4.0}, effects={"elastic_layer": {}})
    _, _, other = contact(gs.Simulator(ball), start, 3)
    assert known.recognize(*other, guess=guess).status != RecognitionStatus.FOUND
    names = {status.name: status.value for status in RecognitionStatus}
    assert gs._native.recognition_statuses() == names
    assert PartSurface().recognize(*seen, guess=guess).status == RecognitionStatus.TOO_LITTLE
    with pytest.raises(ValueError, match="the contact 0, the guess"):
        known.recognize(np.zeros((0, 3)), np.zeros((0, 3)), [], guess=guess)
    with pytest.raises(ValueError, match="valid are points with normals"):
        known.recognize(*seen, guess=guess, guess_sigma=(0.0, 1.0))
    with pytest.raises(gs.PoseError):
        known.recognize(*seen, guess=2.0 * guess)


def test_invalid_points_are_refused() -> None:
    with pytest.raises(ValueError, match=r"the voxel is 0\.0 mm wide"):
        PartSurface(0.0)
    surface = PartSurface()
    with pytest.raises(ValueError, match=r"\(2, 3\), the normals \(1, 3\)"):
        surface.add(np.zeros((2, 3)), np.zeros((1, 3)), [1.0, 1.0])
    with pytest.raises(ValueError, match="is not positive"):
        surface.add([[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]], [0.0])
    with pytest.raises(ValueError, match="is not finite"):
        surface.add([[0.0, np.nan, 1.0]], [[0.0, 0.0, 1.0]], [0.1])
    with pytest.raises(gs.TemplateError, match="the surface has no points"):
        surface.template()
    assert len(surface) == 0 and repr(surface) == "<PartSurface: 0 points, 0.3 mm apart>"
