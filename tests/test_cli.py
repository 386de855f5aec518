"""The command line: examples in every help, one line for every error, and results that other programs can
read.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from test_templates import ball_points, write_scan

from gelstereo import Scene, Template, simulate
from gelstereo.cli import main
from gelstereo.cli.main import COMMANDS
from gelstereo.geometry import se3_exp

SCENE = """
frame_rate_hz = 4
[indenter]
kind = "box"
size_mm = [8.0, 6.0, 20.0]
[effects]
sensor_noise = {}
[[trajectory]]
time_s = 0.0
position_mm = [4.0, 0.0, 40.0]
[[trajectory]]
time_s = 0.5
position_mm = [4.0, 0.0, 37.2]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three stereo frames of a box that is pressed in."""
    path = tmp_path_factory.mktemp("scene")
    (path / "scene.toml").write_text(SCENE)
    assert main(["simulate", str(path / "scene.toml"), "--output", str(path / "frames")]) == 0
    trimesh.creation.box((0.008, 0.006, 0.020)).export(path / "box.stl")
    return path


def error_of(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("gelstereo: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    "command", ["", *(name for name in COMMANDS if name not in ("calibrate", "frontier"))]
)
def test_help_shows_examples(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    package = COMMANDS[command][0].rpartition(".")[0] if command else "gelstereo"
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    with pytest.raises(SystemExit) as stopped:
        main([*command.split(), "--help"])
    assert stopped.value.code == 0
    assert f"examples:\n  gelstereo {command or 'demo'}" in capsys.readouterr().out


def test_simulate_writes_what_the_scene_says(folder: Path) -> None:
    frames = folder / "frames"
    simulator = simulate(folder / "scene.toml")
    truth = np.load(frames / "truth.npz")
    assert truth["points_mm"].shape == (3, 625, 3)
    for index in range(3):
        for view in ("left", "right"):
            image = cv2.imread(str(frames / view / f"{index:04d}.png"), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(image, getattr(simulator[index], view))
        assert np.array_equal(truth["t_sensor_object"][index], simulator[index].t_sensor_object)
    assert Scene.load(frames / "scene.toml").rig == simulator.scene.rig


def test_localize_from_images_and_from_points(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = [
        "--template",
        folder / "box.stl",
        "--units",
        "m",
        "--guess-mm",
        4.1,
        0.1,
        37.3,
        "--guess-deg",
        1,
        1,
        0,
    ]
    capsys.readouterr()
    assert main([str(w) for w in ["localize", "--images", folder / "frames", *part]]) == 0
    found = json.loads(capsys.readouterr().out)
    # A flat face leaves two slides and a spin free; height and tilt are those of the scene.
    pose = np.array(found["t_sensor_object"])
    assert pose[2, 3] == pytest.approx(37.2, abs=0.02)
    assert pose[2, 2] == pytest.approx(1.0, abs=1e-4)
    assert found["points"] > 40
    truth = np.load(folder / "frames" / "truth.npz")
    np.savetxt(
        folder / "patch.csv", truth["points_mm"][-1][truth["in_contact"][-1]], delimiter=",", header="x,y,z"
    )
    out = folder / "pose.json"
    assert main([str(w) for w in ["localize", "--points", folder / "patch.csv", *part, "--output", out]]) == 0
    assert json.loads(out.read_text())["t_sensor_object"][2][3] == pytest.approx(37.2, abs=0.01)
    # With a guess that the part cannot have come from, the best pose explains nothing, and a script can tell.
    part[part.index("--guess-deg") + 1] = 90
    words = ["localize", "--images", folder / "frames", *part]
    capsys.readouterr()
    assert main([str(w) for w in words]) == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["verdict"] == "does_not_fit" and "does not explain the contact" in said.err


@pytest.mark.parametrize("kind", [".npy", ".ply", ".csv", ".txt"])
def test_point_clouds_of_every_kind(kind: str, tmp_path: Path) -> None:
    from gelstereo.point_files import read_points

    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32).astype(np.float64)
    path = tmp_path / f"cloud{kind}"
    if kind == ".npy":
        np.save(path, points)
    elif kind == ".ply":
        trimesh.PointCloud(points).export(path)
    else:
        np.savetxt(path, points, delimiter="," if kind == ".csv" else " ", fmt="%.17g")
    assert np.allclose(read_points(path), points, rtol=1e-6)


def test_view_draws_a_folder(folder: Path) -> None:
    picture = folder / "press.png"
    assert main(["view", str(folder / "frames"), "--frame", "1", "--output", str(picture)]) == 0
    image = cv2.imread(str(picture))
    assert image.shape[1] > 1200
    assert image.std() > 20


def test_errors_are_one_line_that_names_the_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "absent.toml" in error_of(capsys, "simulate", "absent.toml", "--output", folder / "x")
    (folder / "bad.toml").write_text("[gel]\nrowz = 3\n")
    assert "rowz" in error_of(capsys, "simulate", folder / "bad.toml", "--output", folder / "x")
    part = ["--template", folder / "box.stl", "--units"]
    assert "units='m'" in error_of(capsys, "localize", "--points", folder / "patch.csv", *part, "mm")
    (folder / "bad.npy").write_bytes(b"hello")
    assert "bad.npy" in error_of(capsys, "localize", "--points", folder / "bad.npy", *part, "m")
    assert "no images" in error_of(capsys, "view", folder, "--output", folder / "x.png")
    assert "valid is one of" in error_of(capsys, "view", folder / "frames", "--output", folder / "x.doc")
    assert "no frame 9" in error_of(
        capsys, "view", folder / "frames", "--frame", 9, "--output", folder / "x.png"
    )
    assert "bad.npy" in error_of(capsys, "view", folder / "bad.npy", "--output", folder / "x.png")


def test_what_is_no_point_cloud_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    np.save(tmp_path / "complex.npy", np.zeros((4, 3), complex))
    np.save(tmp_path / "turned.npy", np.zeros((3, 50)))
    np.save(tmp_path / "objects.npy", np.array([{}]), allow_pickle=True)
    for name in ("empty.npy", "empty.csv", "empty.ply"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "header.csv").write_text("x,y,z\n")
    (tmp_path / "noise.csv").write_bytes(bytes(range(128, 256)) * 20)
    part = ["--template", folder / "box.stl", "--units", "m"]
    for path in sorted(tmp_path.iterdir()):
        assert path.name in error_of(capsys, "localize", "--points", path, *part)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "dae", "3mf", "glb"])
def test_noise_is_no_mesh(kind: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / f"noise.{kind}"
    path.write_bytes(np.random.default_rng(0).bytes(30_000))
    np.save(tmp_path / "points.npy", np.eye(3))
    points = ["--points", tmp_path / "points.npy", "--units", "mm"]
    assert "cannot be read as a triangle mesh" in error_of(capsys, "localize", *points, "--template", path)


def test_commands_name_the_file_the_frame_and_the_pattern(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "empty.toml").write_text("")
    look = ["view", folder / "frames", "--output", tmp_path / "x.png"]
    assert "empty.toml: " in error_of(capsys, *look, "--rig", tmp_path / "empty.toml")
    assert error_of(capsys, *look, "--rig", "absent.toml").startswith("gelstereo: absent.toml: No such file")
    for index in (3, -1):
        words = ["simulate", folder / "scene.toml", "--output", tmp_path, "--frames", index]
        assert f"no frame {index}; the scene has 3" in error_of(capsys, *words)
    board = ["--right", "b*.png", "--board", "9x6", "--square-mm", 2]
    for pattern in ("", "/", "absent*.png"):
        assert f"no file matches '{pattern}'" in error_of(capsys, "calibrate", "--left", pattern, *board)


@pytest.mark.parametrize(("package", "extra"), [("scipy", "gelstereo[fem]"), ("matplotlib", "./bench")])
def test_a_missing_extra_is_named(
    package: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith("gelstereo_bench.frontier")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [package, *(name for name in sys.modules if name.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    said = error_of(capsys, "frontier", "--quick")
    assert f"{package}, which is not installed: pip install '{extra}'" in said


def test_a_lone_image_is_named(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for view in ("left", "right"):
        (tmp_path / view).mkdir()
    cv2.imwrite(str(tmp_path / "left" / "7.png"), np.zeros((4, 4), np.uint8))
    assert "7.png exists in only one" in error_of(capsys, "view", tmp_path, "--output", folder / "x.png")


def test_ctrl_c_stops_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import gelstereo.cli.demo

    def interrupted(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(gelstereo.cli.demo, "run", interrupted)
    assert main(["demo"]) == 130
    assert capsys.readouterr().err == "\nstopped\n"


def test_the_installed_program_runs_the_demo(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "import sys; from gelstereo.cli import main; sys.exit(main())", "demo"]
    picture = tmp_path / "demo.png"
    done = subprocess.run([*command, "--output", picture], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    lines = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert lines["free"].startswith("slide along z; spin about z")
    # Simulated, with noise. The pose's own covariance has standard deviations of 0.064 deg and 0.012 mm;
    # within three and two and a half of them.
    degrees, millimetres = float(lines["error"].split()[0]), float(lines["error"].split()[2])
    assert degrees < 0.19
    assert millimetres < 0.03
    assert cv2.imread(str(picture)) is not None


def test_guesses_are_poses() -> None:
    import argparse

    from gelstereo.cli.options import add_guess, guess_of

    parser = argparse.ArgumentParser()
    add_guess(parser)
    pose = guess_of(parser.parse_args(["--guess-mm", "1", "2", "3", "--guess-deg", "0", "90", "0"]))
    assert np.array_equal(pose[:3, 3], [1, 2, 3])
    assert np.allclose(pose[:3, :3], se3_exp([0, np.pi / 2, 0, 0, 0, 0])[:3, :3])


def test_template_tells_what_a_mesh_is_and_draws_and_saves_it(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, saved = tmp_path / "box.png", tmp_path / "box.template"
    words = ["template", folder / "box.stl", "--units", "m", "--output", picture, "--save", saved]
    assert main([str(word) for word in words]) == 0
    out = capsys.readouterr().out
    assert "8 x 6 x 20 mm, 12 triangles" in out
    assert "closed, volume 960 mm3" in out
    assert "same to 0.02 mm after 2 turns about" in out
    image = cv2.imread(str(picture))
    assert image is not None and image.std() > 10.0
    # What a gel can touch: the face toward the camera. What that leaves free stays at the guess.
    template = Template.load(saved)
    np.save(tmp_path / "patch.npy", template.points_mm[template.normals[:, 2] < -0.5])
    words = ["localize", "--points", tmp_path / "patch.npy", "--template", saved]
    assert main([str(word) for word in words]) == 0
    pose = np.array(json.loads(capsys.readouterr().out)["t_sensor_object"])
    np.testing.assert_allclose(pose, np.eye(4), atol=0.01)
    assert "units is None; valid is one of 'mm'" in error_of(capsys, "template", folder / "box.stl")


def test_template_of_a_scan_is_drawn_and_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = ball_points(4000, 6.0)
    write_scan(tmp_path / "scan.ply", points, points / 6.0)
    picture, saved = tmp_path / "scan.png", tmp_path / "scan.template"
    words = ["template", tmp_path / "scan.ply", "--units", "mm", "--spacing-mm", 0.5, "--output", picture]
    assert main([str(word) for word in [*words, "--save", saved]]) == 0
    template = Template.load(saved)
    assert f"a scan without triangles, {len(template)} points 0.5 mm apart" in capsys.readouterr().out
    # A ball's silhouette is a disc: in every direction as wide, and without a gap.
    image = cv2.imread(str(picture))[96:]
    drawn = (image.max(axis=2) < 235)[:, 100:]
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert abs(int(height) - int(width)) <= 4
    # Notes and axes stand beside it.
    assert drawn.sum() / (np.pi / 4.0 * height * width) > 0.95
    assert "units is None; valid is one of 'mm'" in error_of(capsys, "template", tmp_path / "scan.ply")
