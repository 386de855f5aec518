"""Nearest points of a template's exact surface, against trimesh, and what is kept with a template."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import DATA

from gelstereo import MeshError, ShapeError, Symmetry, Template, TemplateError

MESHES = [*sorted(DATA.glob("factory_meshes/*.obj")), *sorted(DATA.glob("meshes_realsense/*.stl"))]


def lump(seed: int) -> trimesh.Trimesh:
    """A closed body that does not cross itself: a ball with a different radius in every direction."""
    random = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=3)
    shift = random.normal(size=(4, 3))
    bumps = 1.0 + 0.25 * np.sin(mesh.vertices @ shift.T * 2.0).mean(axis=1)
    return trimesh.Trimesh(mesh.vertices * 6.0 * bumps[:, None], mesh.faces, process=False)


def around(mesh: trimesh.Trimesh, seed: int, count: int = 300) -> np.ndarray:
    random = np.random.default_rng(seed)
    on = mesh.triangles[random.integers(len(mesh.faces), size=count)]
    weights = random.dirichlet([1.0, 1.0, 1.0], size=count)
    # Some exactly at corners and on edges.
    weights[: count // 3] = np.eye(3)[random.integers(3, size=count // 3)]
    weights[count // 3 : count // 2, 0] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    off = random.normal(size=(count, 3)) * random.choice([0.0, 1e-9, 0.1, 2.0], size=(count, 1))
    return np.einsum("ni,nij->nj", weights, on) + off


def brute_force(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distance to every triangle, by trimesh's own closest point on a triangle; the least."""
    distances = []
    for point in points:
        repeated = np.broadcast_to(point, (len(mesh.faces), 3))
        near = trimesh.triangles.closest_point(mesh.triangles, repeated)
        distances.append(np.linalg.norm(near - point, axis=1).min())
    return np.array(distances)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_nearest_points_are_those_of_every_triangle(seed: int) -> None:
    mesh = lump(seed)
    points = around(mesh, seed, 60)
    found = Template.from_triangles(mesh.vertices, mesh.faces, spacing_mm=1.0).closest(points)
    # Both are right to some rounding of 10 mm; trimesh's barycentric one loses a digit or two on flat
    # triangles.
    np.testing.assert_allclose(np.abs(found.distances_mm), brute_force(mesh, points), rtol=0, atol=1e-13 * 10)
    np.testing.assert_allclose(
        np.linalg.norm(found.points_mm - points, axis=1), np.abs(found.distances_mm), rtol=0, atol=1e-14
    )
    on = trimesh.triangles.closest_point(mesh.triangles[found.triangles], found.points_mm)
    np.testing.assert_allclose(on, found.points_mm, rtol=0, atol=1e-12)


def test_signs_are_those_of_the_ray_and_features_those_of_the_place() -> None:
    mesh = lump(1)
    template = Template.from_triangles(mesh.vertices, mesh.faces, spacing_mm=1.0)
    points = np.random.default_rng(2).uniform(-9.0, 9.0, size=(3000, 3))
    found = template.closest(points)
    # trimesh counts crossings of a ray; its signed distance is positive inside.
    assert np.array_equal(found.distances_mm < 0.0, mesh.contains(points))
    assert set(found.features) == {0, 1, 2}
    at_vertex = found.points_mm[found.features == 2]
    assert np.all(np.isin(at_vertex, mesh.vertices).all(axis=1))
    assert template.surface is not None and template.surface.is_closed
    np.testing.assert_allclose(template.surface.volume_mm3, mesh.volume, rtol=1e-12)
    # A first guess changes nothing, be it good, bad or none.
    for near in (found.triangles, found.triangles[::-1], np.full(len(points), -1)):
        again = template.closest(points, near=near)
        assert np.array_equal(again.points_mm, found.points_mm)
        assert np.array_equal(again.triangles, found.triangles)
    with pytest.raises(ShapeError, match="1 triangles for 3000 points"):
        template.closest(points, near=[1])


@pytest.mark.skipif(not MESHES, reason=f"the real meshes are not at {DATA} (set GELSTEREO_DATA)")
@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::gelstereo.templates.MeshWarning")
def test_real_parts_agree_with_trimesh(path: Path) -> None:
    template = Template.from_mesh(path, units="m", spacing_mm=1.0)
    mesh = trimesh.load(path, force="mesh", process=False)
    mesh.apply_scale(1000.0)
    points = around(mesh, 3, 200)
    np.testing.assert_allclose(
        np.abs(template.closest(points).distances_mm), brute_force(mesh, points), rtol=0, atol=1e-9
    )


def test_a_thin_plate_answers_with_the_side_that_is_asked_for() -> None:
    plate = trimesh.creation.box((20.0, 20.0, 0.4))
    template = Template.from_triangles(plate.vertices, plate.faces, spacing_mm=1.0)
    points = [[1.0, 2.0, -0.15], [3.0, 1.0, 0.3]]
    assert template.closest(points).normals[0, 2] == -1.0
    for facing in ([0.0, 0.0, 1.0], [[0.0, 0.0, 2.0]] * 2):
        found = template.closest(points, facing=facing)
        np.testing.assert_allclose(found.distances_mm, [-0.35, 0.1], atol=1e-15)
        assert np.all(found.normals[:, 2] == 1.0)
    far = template.closest([[0.0, 0.0, 9.0]], reach_mm=1.0)
    assert far.distances_mm[0] == np.inf and far.triangles[0] == -1 and np.isnan(far.points_mm).all()
    with pytest.raises(ShapeError, match="3 directions for 2 points"):
        template.closest(points, facing=np.ones((3, 3)))


def test_the_grid_is_near_the_exact_distance() -> None:
    mesh = lump(4)
    exact = Template.from_triangles(mesh.vertices, mesh.faces, spacing_mm=1.0)
    template = exact.with_grid(cell_mm=0.5, reach_mm=1.5)
    points = around(mesh, 5)
    distances, gradients = template.grid_distance(points)
    known = np.isfinite(distances)
    true = exact.closest(points).distances_mm
    assert known[np.abs(true) < 1.0].all() and not known[np.abs(true) > 2.0].any()
    error = distances[known] - true[known]
    assert np.abs(error).max() < 0.87 * 0.5 and np.sqrt(np.mean(error**2)) < 0.02
    assert np.isnan(gradients[~known]).all()
    # A template of a mesh has a grid of its own.
    own, _ = exact.grid_distance(points)
    assert np.nanmax(np.abs(own - true)) < 0.87 * 0.4
    bare = Template.from_points(exact.points_mm, exact.normals, 1.0)
    with pytest.raises(TemplateError, match="has no grid"):
        bare.grid_distance(points)
    with pytest.raises(TemplateError, match="a reach of 2 to 1000 cells"):
        exact.with_grid(cell_mm=1.0, reach_mm=1.0)


def test_templates_are_saved_and_loaded(tmp_path: Path) -> None:
    box = trimesh.creation.box((6.0, 8.0, 10.0))
    template = Template.from_triangles(box.vertices, box.faces, spacing_mm=0.5).with_grid().with_symmetries()
    assert [axis.order for axis in template.symmetries] == [2, 2, 2]
    path = tmp_path / "part.template"
    template.save(path)
    again = Template.load(path)
    assert again.digest == template.digest
    assert [str(axis) for axis in again.symmetries] == [str(axis) for axis in template.symmetries]
    assert again.closest([[9.0, 0.0, 0.0]]).distances_mm[0] == 6.0
    content = path.read_bytes()
    path.write_bytes(content[:-100])
    with pytest.raises(TemplateError, match=r"part\.template: the template is damaged or cut off"):
        Template.load(path)
    path.write_bytes(b"solid part")
    with pytest.raises(TemplateError, match="not the bytes of a template"):
        Template.load(path)
    with pytest.raises(FileNotFoundError):
        Template.load(tmp_path / "none")


def test_symmetries_are_found_or_declared() -> None:
    pin = trimesh.creation.cylinder(radius=4.0, height=12.0, sections=128)
    found = Template.from_triangles(pin.vertices, pin.faces, spacing_mm=0.5).with_symmetries()
    assert [axis.order for axis in found.symmetries] == [None, 2]
    np.testing.assert_allclose(np.abs(found.symmetries[0].axis), [0.0, 0.0, 1.0], atol=1e-9)
    declared = found.with_symmetries([Symmetry([0, 0, 2], [0, 0, 0], 6)])
    (axis,) = declared.symmetries
    assert axis.order == 6 and axis.axis[2] == 1.0
    # Registration may answer with another copy.
    assert declared.digest != found.digest
    np.testing.assert_allclose(axis.turned(np.pi / 3)[:3, 0], [0.5, np.sqrt(0.75), 0.0], atol=1e-15)
    with pytest.raises(TemplateError, match="an order of 2 or more"):
        Symmetry([0, 0, 1], [0, 0, 0], 1)


def test_points_have_no_exact_surface() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))
    template = Template.from_points(points, points, 0.5)
    assert template.surface is None and template.symmetries == ()
    for call in (lambda: template.closest(points), lambda: template.with_grid(), template.with_symmetries):
        with pytest.raises(TemplateError, match="made of points and has no exact surface"):
            call()


def test_what_a_mesh_lacks_is_told() -> None:
    box = trimesh.creation.box((6.0, 8.0, 10.0))
    open_box = Template.from_triangles(box.vertices, box.faces[1:], spacing_mm=0.5).surface
    assert open_box is not None and not open_box.is_closed and open_box.boundary_edges == 3
    turned = Template.from_triangles(box.vertices, box.faces[:, ::-1], spacing_mm=0.5).surface
    assert turned is not None and turned.is_inside_out and turned.volume_mm3 == pytest.approx(-480.0)
    with pytest.raises(MeshError):
        Template.from_triangles([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
