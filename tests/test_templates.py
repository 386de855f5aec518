"""Templates from meshes: units, sampling, and registration of contacts with them."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from real_data import DATA
from step_file import write_box, write_pin

from gelstereo import MeshError, Params, RegisterError, ShapeError, Template, TemplateError, localize
from gelstereo.geometry import nearest, se3_exp, se3_log, shape_mesh
from gelstereo.templates import MeshWarning, load_mesh

MESHES = [*sorted(DATA.glob("factory_meshes/*.obj")), *sorted(DATA.glob("meshes_realsense/*.stl"))]
CLOSE = Params().replace({"register.method": "surface_close"})


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((16.0, 16.0, 50.0))


@pytest.mark.filterwarnings("ignore::gelstereo.templates.MeshWarning")
@pytest.mark.skipif(not MESHES, reason=f"the real meshes are not at {DATA} (set GELSTEREO_DATA)")
def test_real_meshes_are_in_metres() -> None:
    for path in MESHES:
        with pytest.raises(MeshError, match="try units='m'"):
            Template.from_mesh(path, units="mm", spacing_mm=1.0)
        template = Template.from_mesh(str(path), units="m", spacing_mm=1.0)
        size = np.ptp(template.points_mm, axis=0)
        assert 5.0 < size.max() < 100.0, path.name
        assert len(template) > 100


@pytest.mark.parametrize(
    ("extents", "units", "guess"),
    [
        ((0.016, 0.016, 0.05), "mm", "'m'"),  # a 50 mm bolt that was written in metres
        ((16.0, 16.0, 50.0), "m", "'mm'"),  # and one of 50 m
        ((50000.0, 16.0, 16.0), "m", None),  # no unit makes this a part
    ],
)
def test_absurd_sizes_are_refused_with_a_guess(
    extents: tuple[float, ...], units: str, guess: str | None
) -> None:
    mesh = trimesh.creation.box(extents)
    with pytest.raises(MeshError, match=r"the extents are .* valid is") as caught:
        Template.from_mesh(mesh, units=units)  # type: ignore[arg-type]
    assert ("try units=" in str(caught.value)) == (guess is not None)
    assert guess is None or f"try units={guess}" in str(caught.value)


def test_units_scale(box: trimesh.Trimesh) -> None:
    in_mm, _ = load_mesh(box, "mm")
    for units, per_mm in [("m", 1e-3), ("cm", 0.1), ("inch", 1 / 25.4)]:
        scaled = trimesh.Trimesh(box.vertices * per_mm, box.faces, process=False)
        vertices, _ = load_mesh(scaled, units)  # type: ignore[arg-type]
        assert np.allclose(vertices, in_mm, rtol=4 * 2.0**-53, atol=0)
    with pytest.raises(MeshError, match="valid is one of 'mm', 'cm', 'm', 'inch'"):
        Template.from_mesh(box, units="furlong")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="units"):
        Template.from_mesh(box)  # type: ignore[call-arg]


def test_files_that_are_no_mesh(tmp_path: Path, box: trimesh.Trimesh) -> None:
    with pytest.raises(FileNotFoundError, match="absent"):
        Template.from_mesh(tmp_path / "absent.stl", units="mm")
    box.export(tmp_path / "box.stl")
    cut = (tmp_path / "box.stl").read_bytes()[:300]
    for name, content, why in [
        ("empty.stl", b"", "no triangles"),
        # What trimesh takes for text it decodes with another package, if that is installed.
        ("cut.stl", cut, "(no triangles|another package)"),
        ("text.obj", b"hello", "(no triangles|another package)"),
        ("cut.ply", b"ply\nformat", "no line 'end_header'"),
        ("odd.xyz9", b"1 2 3", "xyz9"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(MeshError, match=rf"{name}.*{why}.*valid is a complete STL, OBJ, PLY"):
            Template.from_mesh(tmp_path / name, units="mm")
    assert len(Template.from_mesh(tmp_path / "box.stl", units="mm", spacing_mm=1.0)) > 1000


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_vertices_that_are_no_numbers_are_named(bad: float, box: trimesh.Trimesh) -> None:
    vertices = np.array(box.vertices)
    vertices[3, 1] = bad
    with pytest.raises(MeshError, match=r"1 of 8 vertices of the mesh are not finite, vertex 3 first"):
        Template.from_mesh(trimesh.Trimesh(vertices, box.faces, process=False), units="mm")


def test_points_lie_evenly_on_the_surface_with_outward_normals(box: trimesh.Trimesh) -> None:
    spacing_mm = 0.5
    template = Template.from_mesh(box, units="mm", spacing_mm=spacing_mm)
    half = np.array([8.0, 8.0, 25.0])
    beyond = np.abs(template.points_mm) - half
    assert np.abs(beyond.max(axis=1)).max() < 1e-12  # on the surface
    # Outward: a small step along the normal leaves the box.
    assert (np.abs(template.points_mm + 1e-6 * template.normals) > half).any(axis=1).all()
    # One point for every spacing² of area; even sampling varies by far less than a random one's root of N.
    expected = box.area / spacing_mm**2
    assert len(template) == pytest.approx(expected, rel=0.05)
    # And no hole larger than a few spacings.
    on_surface = np.asarray(trimesh.sample.sample_surface(box, 2000, seed=1)[0])
    assert nearest(template.points_mm, on_surface)[1].max() < 3 * spacing_mm


def test_the_same_seed_gives_the_same_points(box: trimesh.Trimesh) -> None:
    digests = [Template.from_mesh(box, units="mm", spacing_mm=1.0, seed=seed).digest for seed in (1, 1, 2)]
    assert digests[0] == digests[1] != digests[2]


def test_what_is_no_template() -> None:
    with pytest.raises(TemplateError):
        Template.from_points(np.empty((0, 3)), np.empty((0, 3)), 0.3)
    with pytest.raises(ShapeError, match=r"normals has the shape \(3, 2\)"):
        Template.from_points(np.zeros((3, 3)), np.zeros((3, 2)), 0.3)
    with pytest.raises(MeshError, match="names vertex 7"):
        Template.from_triangles(np.eye(3), [[0, 1, 7]])
    with pytest.raises(MeshError, match="names vertex"):
        Template.from_triangles(np.eye(3), [[0, 1, -1]])


def board_contact(t_sensor_object: np.ndarray, noise_mm: float) -> np.ndarray:
    """Points of three faces of a box's corner, in the sensor frame: no direction is free."""
    rng = np.random.default_rng(5)
    flat = rng.uniform(-8.0, 8.0, (300, 3))
    for axis in range(3):
        flat[axis::3, axis] = 8.0 if axis < 2 else 25.0
    flat[:, 2] = np.where(np.arange(300) % 3 == 2, 25.0, np.abs(flat[:, 2]) + 16.0)
    points = flat + noise_mm * rng.normal(size=flat.shape)
    return points @ t_sensor_object[:3, :3].T + t_sensor_object[:3, 3]


def test_localize_finds_a_corner_within_its_own_covariance(box: trimesh.Trimesh) -> None:
    template = Template.from_mesh(box, units="mm", spacing_mm=0.3)
    truth = np.array(se3_exp([0.2, -0.1, 0.3, 4.0, 1.0, 30.0]))
    guess = truth @ se3_exp([0.03, -0.03, 0.02, 0.3, -0.3, 0.2])
    noise_mm = 0.03
    params = CLOSE.replace({"register.point_sigma_mm": noise_mm})
    points, way = board_contact(truth, noise_mm), truth[:3, :3].sum(axis=1)
    found = localize(points, template, guess=guess, params=params, press_direction=way)
    assert found.converged
    assert found.free == ()
    assert found.points == 300
    assert np.array_equal(found.information, found.information.T)
    # The covariance is the inverse of the information where nothing is free.
    assert np.allclose(found.determined_covariance @ found.information, np.eye(6), atol=1e-6)
    twist = np.array(se3_log(truth @ np.linalg.inv(found.t_sensor_object)))
    # Squared Mahalanobis distance of six dimensions: 99.99 % lie below 27.9; a sampled template adds its own
    # error of up to the share of the spacing, so twice the deviation is granted.
    assert twist @ found.information @ twist < 4 * 27.9
    again = localize(points, template, guess=guess, params=params, press_direction=way)
    assert again.digest == found.digest


def test_localize_names_what_a_cylinder_leaves_free() -> None:
    template = Template.from_triangles(*shape_mesh({"kind": "cylinder", "radius_mm": 4.0, "length_mm": 40.0}))
    rng = np.random.default_rng(2)
    angle, height = rng.uniform(-0.8, 0.8, 200), rng.uniform(-8.0, 8.0, 200)
    points = np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), height]) + 0.01 * rng.normal(
        size=(200, 3)
    )
    guess = se3_exp([0.01, 0.01, 0, 0.1, 0.1, 0])
    found = localize(points, template, guess=guess, params=CLOSE, press_direction=(1, 0, 0))
    words = [str(direction) for direction in found.free]
    assert [text.split()[:3] for text in words] == [["slide", "along", "z"], ["spin", "about", "z"]]
    slide, spin = found.free
    assert np.abs(np.abs(slide.v) - [0, 0, 1]).max() < 1e-2
    assert not slide.omega.any()
    # The spin turns about the cylinder's axis, which its twist puts beside the patch's centre.
    on_axis = spin.centre_mm + np.cross(spin.omega, spin.v)
    # Known no better than the noise of the points lets it be: three times register.point_sigma_mm.
    assert np.abs(on_axis[:2]).max() < 3 * CLOSE.to_dict()["register"]["point_sigma_mm"]


REGISTER = """
import numpy as np
from gelstereo import Params, Template, geometry, localize
template = Template.from_triangles(*geometry.shape_mesh({"kind": "sphere", "radius_mm": 4.0}), spacing_mm=0.5)
points = template.points_mm[template.points_mm[:, 2] < -2.0]
guess = geometry.se3_exp([0.01, -0.02, 0.03, 0.3, -0.2, 0.1])
methods = [Params().replace({"register.method": name})
           for name in ("filterreg_point", "surface_close", "ransac_icp")]
def digests(points=points):
    return [localize(points, template, guess=guess, params=params).digest for params in methods]
"""


def test_row_34_registration_in_threads_processes_and_any_layout() -> None:
    scope: dict[str, Any] = {}
    exec(REGISTER, scope)
    expected = scope["digests"]()
    assert len(set(expected)) == 3
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(lambda _: scope["digests"](), range(2)):
            assert found == expected
    spaced = np.repeat(scope["points"], 2, axis=0)[::2]
    assert not spaced.flags.c_contiguous
    for layout in (spaced, np.asfortranarray(scope["points"]), scope["points"].tolist()):
        assert scope["digests"](layout) == expected
    command = [sys.executable, "-c", REGISTER + "print(*digests())"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert [int(word) for word in done.stdout.split()] == expected


def test_row_06_patches_that_cannot_be_registered(box: trimesh.Trimesh) -> None:
    template = Template.from_mesh(box, units="mm", spacing_mm=1.0)
    for points in (np.empty((0, 3)), np.zeros((1, 3)), np.full((20, 3), np.nan), np.full((20, 3), 1e6)):
        with pytest.raises(RegisterError):
            localize(points, template, guess=np.eye(4))
    with pytest.raises(TypeError, match="guess"):
        localize(np.zeros((10, 3)), template)  # type: ignore[call-arg]
    with pytest.raises(ShapeError, match=r"guess has the shape \(3, 3\); valid is \(4, 4\)"):
        localize(np.zeros((10, 3)), template, guess=np.eye(3))


def test_faces_that_are_inside_out_are_turned_and_said(box: trimesh.Trimesh, tmp_path: Path) -> None:
    right = load_mesh(box, "mm")[1]
    assert np.array_equal(right, box.faces)
    path = tmp_path / "box.ply"
    trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False).export(path)
    with pytest.warns(MeshWarning, match=r"box\.ply: its faces were inside out and have been turned"):
        template = Template.from_mesh(path, units="mm", spacing_mm=1.0)
    assert template.surface is not None and template.surface.volume_mm3 == pytest.approx(box.volume)
    stray = box.faces.copy()
    stray[3] = stray[3, ::-1]
    with pytest.warns(MeshWarning, match="the mesh: 1 of 12 triangles faced the wrong way"):
        _, triangles = load_mesh(trimesh.Trimesh(box.vertices, stray, process=False), "mm")
    surface = Template.from_triangles(box.vertices, triangles, spacing_mm=1.0).surface
    assert surface is not None and surface.is_closed


def test_a_scan_with_noise_and_a_hole_is_told_of_and_used() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=8.0)
    noise = np.random.default_rng(1).normal(0.0, 0.02, size=ball.vertices.shape)
    above = ball.triangles_center[:, 2] > -5.0
    scan = trimesh.Trimesh(ball.vertices + noise, ball.faces[above], process=False)
    with pytest.warns(MeshWarning, match=r"it has holes \(\d+ edges"):
        template = Template.from_mesh(scan, units="mm", spacing_mm=0.5)
    assert template.surface is not None and not template.surface.is_closed
    points = ball.vertices[ball.vertices[:, 2] > 0.0]
    # 0.02 mm of noise along three axes, five deviations.
    assert np.abs(template.closest(points).distances_mm).max() < 0.1
    guess = np.eye(4)
    guess[:3, 3] = 0.2
    found = localize(points[:200], template, guess=guess, params=CLOSE, press_direction=(0, 0, 1))
    assert found.rmse_mm < 0.03


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "glb"])
def test_every_kind_of_file_is_read(kind: str, box: trimesh.Trimesh, tmp_path: Path) -> None:
    path = tmp_path / f"box.{kind}"
    box.export(path)
    surface = Template.from_mesh(path, units="mm", spacing_mm=1.0).surface
    assert surface is not None and surface.is_closed and surface.volume_mm3 == pytest.approx(12800.0)


@pytest.mark.parametrize(
    ("unit", "mm"), [("SI_UNIT(.MILLI.,.METRE.)", 1.0), ("SI_UNIT(.CENTI.,.METRE.)", 10.0)]
)
def test_a_step_file_says_its_unit(unit: str, mm: float, tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    path = tmp_path / "box.step"
    write_box(path, (6.0, 4.0, 3.0), unit)
    template = Template.from_mesh(path, units=None, spacing_mm=1.0)
    np.testing.assert_allclose(
        sorted(np.ptp(template.closest(template.points_mm * 3.0).points_mm, axis=0)),
        np.multiply([3.0, 4.0, 6.0], mm),
        rtol=1e-6,
    )
    assert template.surface is not None and template.surface.is_closed
    with pytest.raises(MeshError, match="a STEP file, which states its unit"):
        Template.from_mesh(path, units="mm")
    (tmp_path / "no.step").write_text("nothing")
    with pytest.raises(MeshError, match="cannot be read as a triangle mesh"):
        Template.from_mesh(tmp_path / "no.step", units=None)


@pytest.mark.parametrize(
    ("unit", "mm"), [("SI_UNIT(.MILLI.,.METRE.)", 1.0), ("SI_UNIT($,.METRE.)", 1000.0), ("INCH", 25.4)]
)
def test_a_pin_of_a_step_file_is_as_large_as_its_unit_says(unit: str, mm: float, tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    radius_mm, length_mm = 3.0, 12.7
    path = tmp_path / "pin.stp"
    write_pin(path, radius_mm / mm, length_mm / mm, unit)
    surface = Template.from_mesh(path, units=None, spacing_mm=0.5).surface
    assert surface is not None and surface.is_closed
    # Corners lie on the circle and faces within 0.01 mm of it: a volume of facets, which is less.
    full_mm3 = np.pi * radius_mm**2 * length_mm
    assert 1.0 - 2.0 * 0.01 / radius_mm < surface.volume_mm3 / full_mm3 <= 1.0


WITHOUT_CASCADIO = """
import sys
sys.modules["cascadio"] = None  # Python refuses to import what stands as None.
from gelstereo import MeshError, Template
try:
    Template.from_mesh(sys.argv[1], units=None)
except MeshError as error:
    print(error)
"""


def test_without_cascadio_a_step_file_names_the_extra(tmp_path: Path) -> None:
    write_box(tmp_path / "box.step", (6.0, 4.0, 3.0))
    command = [sys.executable, "-c", WITHOUT_CASCADIO, str(tmp_path / "box.step")]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "box.step" in said and "cascadio" in said and "pip install 'gelstereo[step]'" in said


@pytest.mark.parametrize("radius_mm", [0.5, 4.0, 50.0])
def test_curved_faces_of_a_step_file_are_facets_within_a_hundredth(radius_mm: float, tmp_path: Path) -> None:
    """OpenCASCADE's facets: 0.01 mm from the face at most, whatever the part's size and the file's unit."""
    pytest.importorskip("cascadio")
    write_pin(tmp_path / "pin.step", radius_mm * 1e-3, 0.01, "SI_UNIT($,.METRE.)")
    template = Template.from_mesh(tmp_path / "pin.step", units=None, spacing_mm=0.1 * radius_mm)
    points, normals = template.points_mm, template.normals
    side = np.abs(normals[:, 2]) < 0.5
    beneath_mm = radius_mm - np.hypot(points[side, 0], points[side, 1])
    # Single precision of the file between, and what facets leave.
    assert -1e-6 * radius_mm < beneath_mm.min() and beneath_mm.max() < 0.01
    assert template.surface is not None and template.surface.is_closed
    assert [axis.order for axis in template.with_symmetries().symmetries] == [None, 2]


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_parts_of_a_scene_are_joined_where_they_stand(kind: str, tmp_path: Path) -> None:
    scene, half = trimesh.Scene(), np.array([2.0, 1.5, 8.0])
    place = np.asarray(se3_exp([0.3, -0.2, 0.5, 4.0, 5.0, 6.0]))
    scene.add_geometry(trimesh.creation.box(2.0 * half), transform=place)
    scene.add_geometry(trimesh.creation.box(2.0 * half), transform=np.eye(4))
    scene.export(tmp_path / f"two.{kind}")
    template = Template.from_mesh(tmp_path / f"two.{kind}", units="mm", spacing_mm=0.5)
    assert template.surface is not None
    assert template.surface.volume_mm3 == pytest.approx(2.0 * 8.0 * half.prod(), rel=1e-5)
    # On the faces of one or the other, by each one's own frame.
    back = np.linalg.inv(place)
    placed = template.points_mm @ back[:3, :3].T + back[:3, 3]
    off = [np.abs((np.abs(points) - half).max(axis=1)) for points in (placed, template.points_mm)]
    assert np.minimum(*off).max() < 1e-5


@pytest.mark.filterwarnings("error::gelstereo.templates.MeshWarning")
@pytest.mark.parametrize(
    ("stretch", "least_mm", "most_mm"),
    [
        ((2.0, 2.0, 2.0), (6.0, -3.0, -4.0), (14.0, 3.0, 4.0)),
        # A mirrored node turns its triangles inside out, which is no fault of the file.
        ((-1.0, 1.0, 1.0), (-7.0, -1.5, -2.0), (-3.0, 1.5, 2.0)),
        ((1.0, 2.0, 3.0), (3.0, -3.0, -6.0), (7.0, 3.0, 6.0)),
    ],
)
def test_nodes_of_a_glb_file_stand_in_their_parents_frames(
    stretch: tuple[float, ...], least_mm: tuple[float, ...], most_mm: tuple[float, ...], tmp_path: Path
) -> None:
    """In metres, as the format has it."""
    scene, shift = trimesh.Scene(), np.eye(4)
    shift[0, 3] = 5e-3
    box = trimesh.creation.box((4e-3, 3e-3, 4e-3))
    scene.add_geometry(box, node_name="child", transform=shift)
    scene.graph.update(frame_from="world", frame_to="parent", matrix=np.diag([*stretch, 1.0]))
    scene.graph.update(frame_from="parent", frame_to="child", matrix=shift)
    scene.export(tmp_path / "nested.glb")
    with pytest.raises(MeshError, match="try units='m'"):
        Template.from_mesh(tmp_path / "nested.glb", units="mm")
    template = Template.from_mesh(tmp_path / "nested.glb", units="m", spacing_mm=0.3)
    corners = template.closest(np.array([least_mm, most_mm])).points_mm
    # Single precision of a few millimetres.
    np.testing.assert_allclose(corners, [least_mm, most_mm], atol=2e-6)
    assert template.surface is not None
    assert template.surface.volume_mm3 == pytest.approx(48.0 * abs(np.prod(stretch)), rel=1e-5)


OBJ_GROUPS = """mtllib absent.mtl
o box
v 0 0 0
v 4 0 0
v 4 3 0
v 0 3 0
v 0 0 5
v 4 0 5
v 4 3 5
v 0 3 5
g ends
usemtl a
f 1 4 3 2
usemtl b
f 5 6 7 8
g sides
f 1 2 6 5
f 2 3 7 6
f -6 -5 -1 -2
f 4 1 5 8
"""


def test_groups_of_an_obj_file_are_one_surface(tmp_path: Path) -> None:
    """Faces of four corners, in groups of several materials that share their vertices; some count from the
    end.
    """
    (tmp_path / "groups.obj").write_text(OBJ_GROUPS)
    surface = Template.from_mesh(tmp_path / "groups.obj", units="mm", spacing_mm=0.5).surface
    assert surface is not None and surface.is_closed
    assert surface.volume_mm3 == pytest.approx(60.0, rel=1e-12)


def write_scan(path: Path, points: np.ndarray, normals: np.ndarray | None) -> None:
    """Points without triangles as an ASCII PLY file."""
    names = ["x", "y", "z"] + ([] if normals is None else ["nx", "ny", "nz"])
    rows = points if normals is None else np.hstack([points, normals])
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property double {name}" for name in names] + ["end_header"]
    path.write_text("\n".join([*head, *(" ".join(f"{x:.9g}" for x in row) for row in rows)]) + "\n")


def ball_points(count: int, radius: float) -> np.ndarray:
    """Evenly over a ball (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    return radius * np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])


def test_a_scan_of_points_is_thinned_and_localized(tmp_path: Path) -> None:
    path, radius_mm, noise_mm = tmp_path / "scan.ply", 6.0, 0.02
    points = ball_points(20000, radius_mm)
    noise = noise_mm * np.random.default_rng(4).normal(size=points.shape)
    write_scan(path, (points + noise) * 1e-3, points / radius_mm)
    template = Template.from_mesh(path, units="m", spacing_mm=0.4)
    assert template.surface is None and template.spacing_mm == 0.4
    # One point for every spacing² of area, give or take how many cells a ball crosses.
    assert len(template) == pytest.approx(4.0 * np.pi * radius_mm**2 / 0.4**2, rel=0.1)
    assert Template.from_mesh(path, units="m", spacing_mm=0.4).digest == template.digest
    cap = points[points[:, 2] < -0.8 * radius_mm][::5]
    guess = np.eye(4)
    guess[:3, 3] = [0.1, -0.2, 0.15]
    for method in ("filterreg_point", "surface_close"):
        params = Params().replace({"register.method": method})
        found = localize(cap, template, guess=guess, params=params)
        centre_mm = (
            np.linalg.inv(found.t_sensor_object)[:3, :3].T @ np.zeros(3) + found.t_sensor_object[:3, 3]
        )
        # A ball's centre along the press; the cap of 37 degrees half angle knows it across three times less.
        assert abs(centre_mm[2]) < 3.0 * noise_mm, method
        assert np.abs(centre_mm[:2]).max() < 9.0 * noise_mm, method


def test_a_sparse_scan_says_how_far_its_points_are_apart(tmp_path: Path) -> None:
    points = ball_points(1500, 10.0)
    write_scan(tmp_path / "sparse.ply", points, points)
    template = Template.from_mesh(tmp_path / "sparse.ply", units="mm", spacing_mm=0.25)
    assert len(template) == 1500
    assert template.spacing_mm == pytest.approx(np.sqrt(4.0 * np.pi * 100.0 / 1500), rel=0.15)


def test_scans_that_are_no_template(tmp_path: Path) -> None:
    points, path = ball_points(400, 10.0), tmp_path / "scan.ply"
    write_scan(path, points, None)
    with pytest.raises(
        MeshError, match=r"scan\.ply has no triangles, and its 400 points have no normals; valid is"
    ):
        Template.from_mesh(path, units="mm")
    write_scan(path, points, points)
    with pytest.raises(MeshError, match="try units='mm'"):
        Template.from_mesh(path, units="m")
    with pytest.raises(MeshError, match="valid is one of 'mm'"):
        Template.from_mesh(path, units=None)
    with pytest.warns(MeshWarning, match=r"scan\.ply: its normals look inward"):
        write_scan(path, points, -points)
        Template.from_mesh(path, units="mm")
    write_scan(path, points[:5], points[:5])
    with pytest.raises(MeshError, match="5 points; valid are 6 points or more"):
        Template.from_mesh(path, units="mm")
    write_scan(path, points, np.zeros_like(points))
    with pytest.raises(TemplateError, match="normal"):
        Template.from_mesh(path, units="mm")
    with pytest.raises(TemplateError, match="spacing"):
        Template.from_mesh(path, units="mm", spacing_mm=0.0)
