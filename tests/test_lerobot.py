"""LeRobot itself loads the camera plugin and opens an exported dataset.

It runs in an environment of its own, made once by tests/lerobot/venv.sh: in $GELSTEREO_LEROBOT_VENV, or
.venv-lerobot.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gelstereo as gs
from gelstereo.cli import main

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "scenes" / "grasp_cylinder.toml"
#: Frames of an episode: from rest to a deep press.
STEPS = 32


@pytest.fixture(scope="session")
def lerobot_python() -> str:
    folder = Path(os.environ.get("GELSTEREO_LEROBOT_VENV", ROOT / ".venv-lerobot"))
    made = subprocess.run(
        [ROOT / "tests/lerobot/venv.sh", folder], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return str(folder / "bin" / "python")


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """With the gelstereo that is tested: its library works with every Python from 3.10 on."""
    folder = tmp_path_factory.mktemp("path")
    (folder / "gelstereo").symlink_to(Path(gs.__file__).parent)
    # Nothing may be looked up on the hub, and nothing written to a home.
    home = str(tmp_path_factory.mktemp("home"))
    return {**os.environ, "PYTHONPATH": str(folder), "HF_HUB_OFFLINE": "1", "HF_HOME": home}


def check(python: str, name: str, environment: dict[str, str]) -> None:
    words = ["-q", "-ra", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", "tests/lerobot"]
    command = [python, "-m", "pytest", *words, f"tests/lerobot/{name}"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout and "skipped" not in done.stdout, done.stdout


def test_lerobot_loads_the_camera_plugin(lerobot_python: str, environment: dict[str, str]) -> None:
    check(lerobot_python, "check_camera.py", environment)


def test_lerobot_opens_an_exported_dataset(
    lerobot_python: str, environment: dict[str, str], tmp_path: Path
) -> None:
    probe = [lerobot_python, "-c", "import torch, torchvision, datasets"]
    if subprocess.run(probe, capture_output=True, check=False).returncode != 0:
        pytest.skip("LeRobot's environment has no torch: apt-get install python3-torch python3-torchvision")
    recording, dataset, truth = (tmp_path / name for name in ("run.mcap", "dataset", "truth.npz"))
    words = ["live", "--scene", SCENE, "--frames", STEPS, "--show", "none", "--record", recording]
    assert main([str(word) for word in words]) == 0
    words = ["export", recording, recording, "--to", "lerobot", dataset, "--task", "grasp the peg"]
    assert main([str(word) for word in words]) == 0
    np.savez(truth, **sensed_again())
    places = {"EXPORTED": str(dataset), "TRUTH": str(truth)}
    check(lerobot_python, "check_dataset.py", {**environment, **places})


def sensed_again() -> dict[str, np.ndarray]:
    """What the dataset must hold, by the pipeline and not by the recording."""
    scene = gs.simulate(SCENE)
    pipeline = gs.Pipeline(scene.scene.rig, gs.Params.preset("balanced"))
    frames = [scene[index] for index in range(STEPS)]
    sensed = [pipeline.process(frame.left, frame.right) for frame in frames]
    return {
        "displacement_mm": np.stack([each.points_mm - sensed[0].points_mm for each in sensed]),
        "state": np.stack([each.state for each in sensed]),
        "left": np.stack([frame.left for frame in frames]),
    }
