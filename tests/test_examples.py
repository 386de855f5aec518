"""What the help of a command shows as an example runs as it stands, in a folder with the files
that it names.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from chessboards import TrueRig, write_pairs
from test_calibrate_tags import write as write_tags
from test_templates import ball_points, write_scan

from gelstereo import SlipStatus, simulate
from gelstereo.calibrate import AprilTagBoard, CharucoBoard
from gelstereo.cli import main
from gelstereo.cli.extras import module_of
from gelstereo.cli.main import COMMANDS

SCENES = Path(__file__).parents[1] / "scenes"
PRESS = """
[indenter]
kind = "sphere"
radius_mm = 4.0
[[trajectory]]
time_s = 0.0
position_mm = [4.0, 0.0, 33.0]
[[trajectory]]
time_s = 0.4
position_mm = [4.0, 0.0, 31.0]
"""
LYING = [0.0, np.pi / 2, 0.0]
PEG = {
    "indenter": {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 40.0},
    "trajectory": [{"time_s": 0.0, "position_mm": [4.0, 0.0, 30.7], "rotation_rad": LYING}],
}


def examples(command: str) -> list[list[str]]:
    """Words after `gelstereo`, of every example; what follows two spaces explains it."""
    lines = [line.strip() for line in module_of(command, COMMANDS[command][0]).EXAMPLES.splitlines()]
    found = [re.split(r"\s{2,}", line)[0] for line in lines if line.startswith("gelstereo ")]
    assert found
    return [shlex.split(line)[1:] for line in found]


@pytest.fixture(scope="module")
def press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball pressed in over 13 stereo images, a peg's patch, and meshes of both."""
    folder = tmp_path_factory.mktemp("press")
    (folder / "press.toml").write_text(PRESS)
    assert main(["simulate", str(folder / "press.toml"), "--output", str(folder / "out" / "press")]) == 0
    shutil.copy(folder / "out" / "press" / "rig.toml", folder)
    trimesh.creation.icosphere(5, 0.004).export(folder / "plug.stl")
    trimesh.creation.cylinder(4.0, 40.0, sections=256).export(folder / "peg.stl")
    scan = ball_points(2000, 4.0)
    write_scan(folder / "scan.ply", scan, scan / 4.0)
    truth = simulate(PEG)[0]
    np.save(folder / "patch.npy", truth.points_mm[truth.in_contact])
    return folder


@pytest.mark.parametrize(
    "words", [w for name in ("localize", "view", "template") for w in examples(name)], ids=" ".join
)
def test_examples_on_presses_run(words: list[str], press: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(press)
    if "run.mcap" in words:
        host = os.environ.get("GELSTEREO_HOST")
        if not host:
            pytest.skip("$GELSTEREO_HOST is not set: no gelstereo-host to record with")
        subprocess.run([SCENES.parent / host, "run", "--record", "run.mcap"], check=True, capture_output=True)
    assert main(words) == 0


@pytest.mark.parametrize("words", examples("simulate"), ids=" ".join)
def test_examples_of_scenes_run(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(SCENES, tmp_path / "scenes")
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0


@pytest.mark.parametrize("words", examples("dataset"), ids=" ".join)
def test_examples_of_data_sets_run(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(SCENES, tmp_path / "scenes")
    (tmp_path / "varied.toml").write_text("[press]\ndepth_mm = { uniform = [0.3, 1.2] }\n")
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0


def test_examples_of_calibration_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tags = {"charuco:8x6": CharucoBoard((8, 6), 4.0, 3.0), "apriltag:6x4": AprilTagBoard((6, 4), 3.0, 1.0)}
    for board in ("9x6", *tags):
        folder = tmp_path / board.replace(":", "_")
        folder.mkdir()
        if board in tags:
            write_tags(folder, tags[board], 5, 0.0)
        else:
            write_pairs(folder, TrueRig.typical(), 5)
    for words in examples("calibrate"):
        monkeypatch.chdir(tmp_path / words[words.index("--board") + 1].replace(":", "_"))
        assert main(words) == 0


def test_examples_of_inspection_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = simulate("marker_field")[0]
    for name, image in (("gel", frame.left), ("left", frame.left), ("right", frame.right)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    monkeypatch.chdir(tmp_path)
    for words in examples("inspect"):
        assert main(words) == 0


@pytest.mark.parametrize("words", examples("live"), ids=" ".join)
def test_examples_of_live_runs_run(words: list[str], press: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not (press / "scenes").exists():
        shutil.copytree(SCENES, press / "scenes")
    monkeypatch.chdir(press)
    assert main([*words, *(["--port", "0"] if "--show" not in words else [])]) == 0


@pytest.mark.parametrize("words", examples("export"), ids=" ".join)
def test_examples_of_exports_run(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = str(SCENES / "grasp_cylinder.toml")
    assert main(["live", "--scene", scene, "--frames", "8", "--show", "none", "--record", "run.mcap"]) == 0
    Path("force.toml").write_text('force = { method = "ridge", thickness_mm = 5.0, young_kpa = 100.0 }')
    assert main(words) == 0


def test_examples_of_the_demo_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for words in examples("demo"):
        assert main(words) == 0


def run_program(name: str, *words: str, folder: Path) -> str:
    """What a program of `examples/` prints."""
    program = [sys.executable, str(SCENES.parent / "examples" / name), *words]
    return subprocess.run(program, cwd=folder, check=True, capture_output=True, text=True).stdout


def test_the_program_for_the_first_pose_runs(tmp_path: Path) -> None:
    said = run_program("first_pose.py", folder=tmp_path)
    assert re.search(r"verdict +fits", said) and "spin about z" in said


def test_the_program_that_follows_a_part_runs(tmp_path: Path) -> None:
    *_, last = run_program("follow_part.py", folder=tmp_path).splitlines()
    assert re.search(r"tracking, fits: x 4\.(49|50)", last)


def test_the_program_for_a_mesh_runs(tmp_path: Path) -> None:
    plug = str(SCENES / "parts" / "usb_plug.stl")
    words = ("--units", "mm", "--turn-deg", "90", "0", "0", "--save", "plug.template")
    said = run_program("part_from_mesh.py", plug, *words, folder=tmp_path)
    assert re.search(r"verdict +fits", said)
    assert [path.name for path in tmp_path.iterdir()] == ["plug.template"]


def test_the_program_in_mujoco_feels_the_weight() -> None:
    """The peg's weight, half of it on each finger, within four standard deviations of the measured wrench."""
    pytest.importorskip("mujoco", reason="PyPI's mujoco is not installed")
    program = runpy.run_path(str(SCENES.parent / "examples" / "mujoco_lift.py"))
    frames = list(program["lift"]())
    weight_n = program["MASS_KG"] * program["GRAVITY_M_S2"]
    on_floor = [now for now in frames if 0.3 < now.time_s < 0.4]
    held = [now for now in frames if now.time_s > 1.0]
    assert len(on_floor) >= 2 and len(held) >= 5
    for now in on_floor + held:
        # The gel pulls as MuJoCo does, to the tolerance that the program states.
        error_n = np.linalg.norm(now.pair.loads.force_n - now.force_n)
        assert error_n < program["FORCE_TOLERANCE_N"]
        sigma_n = np.sqrt(np.diag(now.sensed.wrench.covariance)[:3])
        assert (np.abs(now.sensed.wrench.force_n - now.pair.loads.force_n) < 4.0 * sigma_n).all()
        assert sigma_n[1] < 0.05 * weight_n
    for now in held:
        # MuJoCo's residual acceleration at rest is below a thousandth of gravity.
        limit_n = 4.0 * np.sqrt(now.sensed.wrench.covariance[1, 1]) + program["FORCE_TOLERANCE_N"]
        assert abs(now.sensed.wrench.force_n[1] - 0.5 * weight_n) < limit_n + 0.5e-3 * weight_n
        assert now.height_mm > 19.0 and now.sensed.slip.status != SlipStatus.GROSS
    assert all(abs(now.sensed.wrench.force_n[1]) < 0.1 * weight_n for now in on_floor)
    # Noise alone changes a level by 2 sqrt(2 / pi) of its standard deviation in the mean, 2.3 for 2 levels.
    change = np.abs(held[-1].pair.left.astype(float) - on_floor[-1].pair.left)
    assert np.abs(change[200:280, 250:600]).mean() > 2.0 * 2.3


def test_the_program_for_a_camera_runs(tmp_path: Path) -> None:
    simulator = simulate(PRESS)
    simulator.scene.rig.save(tmp_path / "rig.toml")
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    video = cv2.VideoWriter(str(tmp_path / "press.avi"), codec, 30.0, (1280, 480))
    for moment in simulator:
        video.write(cv2.cvtColor(np.hstack((moment.left, moment.right)), cv2.COLOR_GRAY2BGR))
    video.release()
    words = ("--camera", "press.avi", "--rig", "rig.toml", "--pitch-mm", "0.9")
    lines = run_program("live_camera.py", *words, folder=tmp_path).splitlines()
    assert len(lines) == len(simulator) + 1
    contact = [int(line.split()[2]) for line in lines[:-1]]
    assert contact[0] == 0 and contact[-1] > 20
