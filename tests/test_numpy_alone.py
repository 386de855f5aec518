"""NumPy is all that sensing and localization need; what needs more says in one sentence what to install."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

# Nothing but the standard library, NumPy and gelstereo can be imported after this.
ALONE = """
import json, sys

KEPT = {"numpy", "gelstereo"}

def foreign(name):
    top = name.partition(".")[0]
    return top not in sys.stdlib_module_names | KEPT and not top.startswith("_")

class Refused:
    def find_spec(self, name, path=None, target=None):
        if foreign(name):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for name in [name for name in sys.modules if foreign(name)]:
    del sys.modules[name]
sys.meta_path.insert(0, Refused())
"""

# From images to a pose, with a template from a file.
POSE = """
import numpy as np
import gelstereo as gs

sensor = gs.simulate("grasp_cylinder")
pipeline = gs.Pipeline(sensor.scene.rig, gs.Params.preset("balanced"))
for pair in sensor:
    frame = pipeline.process(pair.left, pair.right)
mesh = gs.geometry.shape_mesh({"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0})
gs.Template.from_triangles(*mesh).save("peg.template")
guess = pair.t_sensor_object @ gs.geometry.se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])
found = gs.localize(frame, gs.Template.load("peg.template"), guess=guess, params=pipeline.params)
error_mm = found.t_sensor_object[:3, 3] - pair.t_sensor_object[:3, 3]
np.save("patch.npy", frame.patch_points_mm)
np.save("guess.npy", guess)
print(json.dumps([found.verdict, len(frame.points_mm), float(abs(error_mm[2]))]))
"""

# Each feature that needs more, with what it says.
FEATURES = """
import gelstereo as gs
from gelstereo import grippers, hid, parts

def chessboards():
    import gelstereo.calibrate

def image_file():
    from gelstereo.cli.files import read_image
    read_image("left.png")

def picture():
    from gelstereo.view.canvas import Canvas
    Canvas(64, 48)

said = {}
for feature in (
    chessboards,
    image_file,
    picture,
    lambda: gs.Template.from_mesh("peg.stl", units="mm"),
    parts.peg_round,
    lambda: grippers.open("robotiq", "/dev/ttyUSB0"),
    hid.devices,
):
    try:
        feature()
    except gs.Error as error:
        said[str(error)] = type(error).__name__
print(json.dumps(said))
"""


def child(code: str, folder: Path) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", ALONE + code], capture_output=True, text=True, cwd=folder, timeout=300.0
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_frame_becomes_a_pose_with_numpy_alone(tmp_path: Path) -> None:
    verdict, markers, error_mm = child(POSE, tmp_path)
    assert (verdict, markers) == ("fits", 625)
    assert error_mm < 0.02


def test_the_command_locates_with_numpy_alone(tmp_path: Path) -> None:
    child(POSE, tmp_path)
    code = """
import numpy as np
from gelstereo.cli.main import main
from gelstereo.geometry import so3_from_matrix, so3_log
guess = np.load("guess.npy")
turn = map(str, np.degrees(so3_log(so3_from_matrix(guess[:3, :3]))))
origin = map(str, guess[:3, 3])
words = ["--points", "patch.npy", "--template", "peg.template", "--guess-mm", *origin, "--guess-deg", *turn]
sys.exit(main(["localize", *words]))
"""
    assert child(code, tmp_path)["verdict"] == "fits"


def test_what_needs_more_names_the_package(tmp_path: Path) -> None:
    opencv = "needs cv2, which is not installed: pip install 'opencv-contrib-python-headless'"
    trimesh = "needs trimesh, which is not installed: pip install 'trimesh'"
    assert child(FEATURES, tmp_path) == {
        f"gelstereo.calibrate.boards {opencv}": "MissingExtra",
        f"gelstereo.cli.files {opencv}": "MissingExtra",
        f"gelstereo.view.canvas {opencv}": "MissingExtra",
        f"gelstereo.templates {trimesh}": "MissingExtra",
        f"gelstereo.parts.sections {trimesh}": "MissingExtra",
        "grippers need pyserial, which is not installed: pip install pyserial": "GripperError",
        "HID devices need hidapi, which is not installed: pip install hidapi": "HidError",
    }
