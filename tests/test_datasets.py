"""Data sets of random scenes: the same for any number of workers, and written in formats that others read."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import gelstereo as gs
from gelstereo.cli.main import main
from gelstereo.datasets import DatasetError, Sample, render, rendering, write_npz, write_zarr
from gelstereo.export.errors import ExportError
from gelstereo.extras import MissingExtra
from gelstereo.randomization import DistributionError

SCENE: dict[str, Any] = {
    "gel": {"rows": 9, "cols": 11},
    "indenter": {"kind": "sphere", "radius_mm": 4.0},
    "effects": {"elastic_layer": {}, "defocus": {}, "sensor_noise": {}},
}
VARIED: dict[str, Any] = {
    "effects.sensor_noise.sigma_levels": {"log_uniform": [0.5, 4.0]},
    "press": {"depth_mm": {"uniform": [0.3, 1.2]}, "shear_mm": [{"uniform": [-0.2, 0.2]}, 0.0]},
}
SIMULATOR = gs.simulate(SCENE)
COUNT = 5


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return list(render(SIMULATOR, VARIED, COUNT, seed=7))


def assert_same(found: Sample, expected: Sample) -> None:
    assert (found.index, found.seed) == (expected.index, expected.seed)
    for ours, theirs in ((found.frames, expected.frames), (found.rest, expected.rest)):
        assert set(ours) == set(theirs)
        for name in ours:
            assert ours[name].dtype == theirs[name].dtype and np.array_equal(ours[name], theirs[name]), name


def test_samples_do_not_depend_on_the_workers(samples: list[Sample], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("joblib")
    monkeypatch.setattr(rendering, "_START_S", 0.0)
    told: list[tuple[int, int]] = []
    for workers, count in ((2, COUNT), (3, COUNT - 1)):
        found = list(
            render(SIMULATOR, VARIED, count, seed=7, workers=workers, progress=lambda *now: told.append(now))
        )
        assert len(found) == count
        for ours, theirs in zip(found, samples, strict=False):
            assert_same(ours, theirs)
    assert told[: COUNT + 1] == [(done, COUNT) for done in range(COUNT + 1)]


def test_a_small_set_starts_no_process(samples: list[Sample], monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting them takes longer than the set; a long sample decides otherwise."""
    joblib = pytest.importorskip("joblib")

    class NoProcessError(Exception):
        pass

    def started(**_: object) -> None:
        raise NoProcessError

    monkeypatch.setattr(joblib, "Parallel", started)
    for ours, theirs in zip(render(SIMULATOR, VARIED, COUNT, seed=7, workers=2), samples, strict=True):
        assert_same(ours, theirs)
    monkeypatch.setattr(rendering, "_START_S", 0.0)
    with pytest.raises(NoProcessError):
        list(render(SIMULATOR, VARIED, COUNT, seed=7, workers=2))


def test_parts_have_their_own_wrenches() -> None:
    """Two parts in one gel: their forces and torques add up, and each touches its own markers."""
    finger = {
        "indenter": {"kind": "box", "size_mm": [3.0, 2.0, 4.0]},
        "trajectory": [{"time_s": 0.0, "position_mm": [11.0, 0.0, 30.2]}],
    }
    scene = {**SCENE, "gel": {}, "others": [finger]}
    [sample] = render(gs.simulate(scene), VARIED, 1, images=False)
    frames = sample.frames
    count = len(frames["time_s"])
    assert frames["part_force_n"].shape == (count, 2, 3) and frames["t_sensor_objects"].shape == (
        count,
        2,
        4,
        4,
    )
    np.testing.assert_allclose(frames["part_force_n"].sum(axis=1), frames["force_n"], atol=1e-9)
    np.testing.assert_allclose(frames["part_torque_nmm"].sum(axis=1), frames["torque_nmm"], atol=1e-7)
    touched = frames["touched_by"]
    assert np.array_equal(touched >= 0, frames["in_contact"]) and {*np.unique(touched)} == {-1, 0, 1}
    assert np.array_equal(frames["t_sensor_objects"][:, 0], frames["t_sensor_object"], equal_nan=True)


@pytest.mark.parametrize("kind", ["npz", "zarr", "lerobot"])
def test_the_command_writes_a_set(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if kind != "npz":
        pytest.importorskip({"zarr": "zarr", "lerobot": "pyarrow"}[kind])
    scene, varied = tmp_path / "scene.toml", tmp_path / "varied.toml"
    SIMULATOR.scene.save(scene)
    varied.write_text("[press]\ndepth_mm = { uniform = [0.3, 1.2] }\n")
    words = ["dataset", scene, "--vary", varied, "--count", 2, "--seed", 7, "--output", tmp_path / "set"]
    words += ["--format", kind, *([] if kind == "npz" else ["--no-images"])]
    assert main([str(word) for word in words]) == 0
    assert "wrote 2 samples of 2 frames" in capsys.readouterr().out
    if kind == "npz":
        data = np.load(tmp_path / "set" / "00000.npz")
        expected = list(render(SIMULATOR, varied, 2, seed=7))
        assert np.array_equal(data["left"], np.concatenate([sample.frames["left"] for sample in expected]))
    assert main([str(word) for word in words]) == 2


def test_a_sample_is_what_the_simulator_shows(samples: list[Sample]) -> None:
    assert len({sample.seed for sample in samples}) == COUNT
    for sample in samples:
        [frame] = SIMULATOR.randomize(VARIED, sample.seed)
        assert np.array_equal(sample.frames["left"][0], frame.left)
        assert not np.array_equal(sample.rest["left"], frame.left)
        loads = frame.loads
        assert loads is not None and np.array_equal(sample.frames["traction_kpa"][0], loads.traction_kpa)
        # The sum of the tractions over the markers' squares, and of their moments, is the wrench; the layer
        # reaches beyond the lattice, which here nothing touches.
        forces_n = sample.frames["traction_kpa"][0] * sample.pitch_mm**2 * 1e-3
        np.testing.assert_allclose(forces_n.sum(axis=0), sample.frames["force_n"][0], atol=2e-3)
        torque_nmm = np.cross(SIMULATOR.press().points_mm, forces_n).sum(axis=0)
        np.testing.assert_allclose(torque_nmm, sample.frames["torque_nmm"][0], atol=0.1)
        moved = np.abs(sample.frames["displacement_mm"][0]).max()
        assert 0.2 < moved < 1.5


def test_without_images_the_rest_is_the_same(samples: list[Sample]) -> None:
    for bare, whole in zip(render(SIMULATOR.scene, VARIED, 2, seed=7, images=False), samples, strict=False):
        assert "left" not in bare.frames and "left" not in bare.rest
        assert np.array_equal(bare.frames["points_mm"], whole.frames["points_mm"])


def test_numpy_files_hold_all_frames(samples: list[Sample], tmp_path: Path) -> None:
    assert write_npz(samples, tmp_path / "set", samples_per_file=2) == COUNT
    files = sorted((tmp_path / "set").iterdir())
    assert [file.name for file in files] == ["00000.npz", "00001.npz", "00002.npz"]
    parts = [dict(np.load(file)) for file in files]
    for name in samples[0].frames:
        together = np.concatenate([part[name] for part in parts])
        assert np.array_equal(together, np.concatenate([sample.frames[name] for sample in samples]))
    assert np.concatenate([part["sample"] for part in parts]).tolist() == list(range(COUNT))
    rest = np.concatenate([part["rest_left"] for part in parts])
    assert np.array_equal(rest[-1], samples[-1].rest["left"]) and len(rest) == COUNT


def test_zarr_arrays_hold_all_frames(samples: list[Sample], tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    many = [samples[k % COUNT] for k in range(37)]  # more than a chunk
    assert write_zarr(many, tmp_path / "set.zarr") == 37
    group = zarr.open_group(str(tmp_path / "set.zarr"), mode="r")
    for name, values in samples[0].frames.items():
        assert group[name].shape == (37, *values.shape[1:]) and group[name].dtype == values.dtype
        assert np.array_equal(group[name][36], samples[36 % COUNT].frames[name][0])
    assert group["seed"][:].tolist() == [sample.seed for sample in many]


def test_lerobot_episodes_have_forces_and_wrenches(samples: list[Sample], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    pytest.importorskip("rosbags")
    from gelstereo.datasets.lerobot import write_lerobot_samples

    scene = SIMULATOR.scene.replace(
        trajectory=[
            {"time_s": 0.0, "position_mm": [4.0, 0.0, 32.5]},
            {"time_s": 0.1, "position_mm": [4.0, 0.0, 32.0]},
        ]
    )
    varied = {name: value for name, value in VARIED.items() if name != "press"}
    [moving] = render(scene, varied, 1)
    episodes = write_lerobot_samples(
        [moving, *samples], tmp_path / "set", task="press", views=("left", "right")
    )
    assert [episode.length for episode in episodes] == [4] + [1] * COUNT
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert info["features"]["observation.tactile.full"]["shape"] == [99, 6]
    for number, sample in enumerate([moving, *samples]):
        table = parquet.read_table(tmp_path / "set" / "data" / "chunk-000" / f"file-{number:03}.parquet")
        column = {
            name.rpartition(".")[2]: np.array(table[name].to_pylist())
            for name in info["features"]
            if "tactile" in name
        }
        np.testing.assert_allclose(column["displacement"], sample.frames["displacement_mm"], atol=1e-6)
        wrench = np.hstack([sample.frames["force_n"], sample.frames["torque_nmm"]])
        np.testing.assert_allclose(column["wrench"], wrench, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(column["force"].sum(axis=1), sample.frames["force_n"], atol=2e-3)
        assert np.array_equal(
            column["full"], np.concatenate([column["displacement"], column["force"]], axis=2)
        )
        assert np.array_equal(column["stick"], sample.frames["stick"])
        np.testing.assert_allclose(
            column["part_pose"][:, :3], sample.frames["t_sensor_object"][:, :3, 3], rtol=1e-6
        )
        png = table["observation.images.right"][0].as_py()["bytes"]
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert np.array_equal(image, sample.frames["right"][0])


def test_what_cannot_be_done_says_why(samples: list[Sample], tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="valid is 1 or more"):
        render(SIMULATOR, VARIED, 0)
    with pytest.raises(DatasetError, match="0 workers"):
        render(SIMULATOR, VARIED, 1, workers=0)
    with pytest.raises(DistributionError, match="highest values"):
        render(SIMULATOR, {"press": {"depth_mm": {"uniform": [0.5, 500000.0]}}}, 10)
    with pytest.raises(DatasetError, match="no sample"):
        write_npz([], tmp_path / "none")
    other = list(render(SIMULATOR, {**VARIED, "gel.rows": 10}, 1))
    with pytest.raises(DatasetError, match=r"sample 0 is .*valid are scenes with the same"):
        write_npz([*samples[1:], *other], tmp_path / "mixed")
    (tmp_path / "taken").mkdir()
    with pytest.raises(ExportError, match="exists"):
        write_npz(samples, tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_a_missing_library_is_named(
    samples: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "zarr", None)
    monkeypatch.setitem(sys.modules, "joblib", None)
    with pytest.raises(MissingExtra, match=r"zarr.*gelstereo\[zarr\]"):
        write_zarr(samples, tmp_path / "set.zarr")
    with pytest.raises(MissingExtra, match=r"2 workers needs joblib.*batch"):
        list(render(SIMULATOR, VARIED, 4, workers=2))


PROGRAM = """
import gelstereo as gs
from gelstereo.datasets import render, write_npz

if __name__ == "__main__":
    simulator = gs.simulate({scene!r})
    told = lambda done, total: print(done, flush=True)
    write_npz(render(simulator, {varied!r}, 100000, workers=2, progress=told), "set")
"""


def test_ctrl_c_stops_all_workers_and_leaves_no_half_set(tmp_path: Path) -> None:
    pytest.importorskip("joblib")
    (tmp_path / "program.py").write_text(PROGRAM.format(scene=SCENE, varied=VARIED))
    with subprocess.Popen(
        [sys.executable, "program.py"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline().strip() != "3":
            assert process.poll() is None
        # The terminal sends it to the whole group; here only to the program.
        process.send_signal(signal.SIGINT)
        start = time.monotonic()
        _, said = process.communicate(timeout=30)
        assert time.monotonic() - start < 10.0
    assert process.returncode != 0 and "KeyboardInterrupt" in said
    assert [path.name for path in tmp_path.iterdir()] == ["program.py"]
