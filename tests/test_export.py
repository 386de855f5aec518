"""Datasets made of recordings, read back by pyarrow; tests/test_lerobot.py opens them with LeRobot's own
loader.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import gelstereo as gs
from gelstereo.cli import main
from gelstereo.live import LiveSensor
from gelstereo.live.source import LiveFrame
from gelstereo.recordings import load_recording

pytest.importorskip("rosbags", reason="PyPI's rosbags is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="PyPI's pyarrow is not installed")

from gelstereo.export.lerobot import export_lerobot  # noqa: E402
from gelstereo.export.recording import ExportError, _messages, recorded_frames  # noqa: E402
from gelstereo.export.statistics import pooled, statistics  # noqa: E402
from gelstereo.export.tactile import force_features  # noqa: E402
from gelstereo.export.timeline import Timeline  # noqa: E402
from gelstereo.live.record import LiveRecorder  # noqa: E402

SCENE = Path(__file__).parents[1] / "scenes" / "grasp_cylinder.toml"
DISPLACEMENT = "observation.tactile.displacement"
POINTS, LEFT = "/gelstereo/points", "/gelstereo/left/image/compressed"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    words = ["live", "--scene", str(SCENE), "--frames", "20", "--show", "none", "--record", str(path)]
    assert main(words) == 0
    return path


def test_the_command_writes_episodes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new" / "dataset"
    words = ["export", recording, recording, "--to", "lerobot", folder, "--task", "grasp", "--images", "both"]
    assert main([str(word) for word in words]) == 0
    assert "20 frames at 30 Hz, 0 repeated, 0 passed over" in capsys.readouterr().out
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 40, 30)
    table = parquet.read_table(folder / "data" / "chunk-000" / "file-001.parquet")
    assert table["index"].to_pylist() == list(range(20, 40))
    scene = gs.simulate(SCENE)
    pipeline = gs.Pipeline(scene.scene.rig, gs.Params.preset("balanced"))
    points = [pipeline.process(scene[k].left, scene[k].right).points_mm for k in range(20)]
    moved = np.array(table[DISPLACEMENT].to_pylist())
    # The recording holds single-precision metres.
    np.testing.assert_allclose(moved, np.stack(points) - points[0], atol=2e-5)
    for view in ("left", "right"):
        png = table[f"observation.images.{view}"][7].as_py()["bytes"]
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(image, np.repeat(getattr(scene[7], view)[:, :, None], 3, axis=2))
    assert sorted(path.name for path in folder.parent.iterdir()) == ["dataset"]


def test_without_images_a_dataset_is_small(recording: Path, tmp_path: Path) -> None:
    folder = tmp_path / "dataset"
    assert (
        main(["export", str(recording), "--to", "lerobot", str(folder), "--images", "none", "--fps", "10"])
        == 0
    )
    table = parquet.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    assert not any("images" in name for name in table.column_names)
    assert table.num_rows == 7 and table["timestamp"].to_pylist() == pytest.approx([k / 10 for k in range(7)])


def test_a_recording_that_was_cut_off_is_exported_up_to_the_cut(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = recording.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    assert 7 <= len(list(recorded_frames(cut))) <= 10


def test_what_cannot_be_exported_says_why_and_leaves_nothing(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def error(*words: object) -> str:
        assert main(["export", *map(str, words)]) == 2
        return capsys.readouterr().err

    text = tmp_path / "text.mcap"
    text.write_text("no recording")
    taken = tmp_path / "taken"
    taken.mkdir()
    new = tmp_path / "new"
    assert "not an MCAP file" in error(text, "--to", "lerobot", new)
    assert "exists; name a new folder" in error(recording, "--to", "lerobot", taken)
    assert "valid is lerobot" in error(recording, "--to", "zarr", new)
    assert "No such file" in error(tmp_path / "nowhere.mcap", "--to", "lerobot", new)
    assert error(recording, text, "--to", "lerobot", new)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken", "text.mcap"]


def test_an_error_on_the_way_leaves_no_half_dataset(recording: Path, tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_lerobot([recording], tmp_path / "dataset", task="grasp", progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_view_that_was_not_recorded_is_an_error(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="--images none"):
        export_lerobot([recording], tmp_path / "dataset", task="grasp", views=("upper",))


def test_a_frame_without_images_has_none(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings may hold the images of one pair in so many: those of another pair are no frame's own."""
    messages = list(_messages(recording, {POINTS, LEFT}))
    images = [n for n, (topic, _) in enumerate(messages) if topic == LEFT]
    kept = [message for n, message in enumerate(messages) if n not in images or images.index(n) % 3 == 0]
    monkeypatch.setattr("gelstereo.export.recording._messages", lambda path, topics: iter(kept))
    frames = list(recorded_frames(recording))
    assert len(frames) == 20
    assert [set(frame.images) for frame in frames] == [{"left"} if n % 3 == 0 else set() for n in range(20)]


def test_of_two_frames_as_near_the_earlier_is_taken() -> None:
    # Quarters of a second, and steps of an eighth: all exact.
    timeline = Timeline.of([250_000_000 * n for n in range(5)], 8)
    assert timeline.taken == [0, 0, 1, 1, 2, 2, 3, 3, 4]


@given(st.lists(st.integers(1_000_000, 400_000_000), min_size=1, max_size=60), st.integers(1, 60))
def test_steps_stand_at_the_nearest_frame(gaps_ns: list[int], fps: int) -> None:
    times_ns = np.cumsum([5_000, *gaps_ns]).tolist()
    timeline = Timeline.of(times_ns, fps)
    assert timeline.taken == sorted(timeline.taken) and timeline.taken[0] == 0
    times_s = (np.array(times_ns) - times_ns[0]) / 1e9
    for step, index in enumerate(timeline.taken):
        distance = np.abs(times_s - step / fps)
        assert distance[index] == pytest.approx(distance.min(), abs=1e-9)
    assert len(timeline.taken) == round(times_s[-1] * fps) + 1
    assert timeline.repeated + len(times_ns) - timeline.passed_over == len(timeline.taken)


@given(st.integers(1, 50), st.integers(1, 90))
def test_a_steady_recording_is_taken_as_it_is(frames: int, rate_hz: int) -> None:
    times_ns = [round(index * 1e9 / rate_hz) for index in range(frames)]
    timeline = Timeline.of(times_ns, None if frames > 1 else rate_hz)
    assert (timeline.taken, timeline.repeated, timeline.passed_over) == (list(range(frames)), 0, 0)
    assert timeline.fps == rate_hz


@given(
    st.lists(
        arrays(np.float64, st.tuples(st.integers(1, 6), st.just(3)), elements=st.floats(-50.0, 50.0)),
        min_size=1,
        max_size=4,
    )
)
def test_pooled_statistics_are_those_of_all(parts: list[np.ndarray]) -> None:
    together, alone = pooled([statistics(part) for part in parts]), statistics(np.concatenate(parts))
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(together[name], alone[name], atol=1e-6, err_msg=name)
    assert (together["q50"] >= alone["min"] - 1e-9).all() and (together["q50"] <= alone["max"] + 1e-9).all()


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[gs.Frame]]:
    """A recording with forces and slip, and its frames: a ball is pressed in and dragged."""
    scene = gs.Scene().replace(
        indenter={"kind": "sphere", "radius_mm": 5.0},
        effects={"elastic_layer": {"friction": 0.4}, "sensor_noise": {}},
        trajectory=[
            {"time_s": 0.0, "position_mm": [4.0, 0.0, 34.0]},
            {"time_s": 0.1, "position_mm": [4.0, 0.0, 32.9]},
            {"time_s": 0.3, "position_mm": [4.5, 0.0, 32.9], "shear_mm": [0.5, 0.0]},
        ],
    )
    params = gs.Params.preset("balanced").replace(
        force={"method": "ridge", "thickness_mm": 5.0, "young_kpa": 100.0},
        slip={"method": "rigid", "frame_rate_hz": 30.0},
    )
    path = tmp_path_factory.mktemp("pressed") / "pressed.mcap"
    sensor = LiveSensor(scene.rig, params)
    frames = []
    with LiveRecorder(path, scene.rig, params) as recorder:
        for index, pair in enumerate(gs.simulate(scene)):
            time_ns = round(pair.time_s * 1e9)
            result = sensor.process(LiveFrame(pair.left, pair.right, index, time_ns))
            assert result.sensed is not None
            frames.append(result.sensed)
            recorder.write(result)
    assert len(frames) == 10 and frames[0].wrench is None and frames[-1].wrench is not None
    return path, frames


def test_forces_are_columns_of_the_tables(pressed: tuple[Path, list[gs.Frame]]) -> None:
    path, frames = pressed
    table = load_recording(path).frame_table()
    for at, frame in enumerate(frames):
        found = [table[name][at] for name in ("fx_n", "fy_n", "fz_n", "tx_nmm", "ty_nmm", "tz_nmm")]
        if frame.wrench is None:
            assert np.isnan(found).all()
        else:
            about_origin = frame.wrench.about([0.0, 0.0, 0.0])
            np.testing.assert_allclose(found, [*about_origin.force_n, *about_origin.torque_nmm], rtol=1e-12)
        status = "" if frame.slip is None else gs.SlipStatus(frame.slip.status).name.lower()
        assert table["slip"][at] == status
        ratio = None if frame.slip is None else frame.slip.stick_ratio
        assert table["stick_ratio"][at] == ratio or (ratio is None and np.isnan(table["stick_ratio"][at]))
    assert {"stuck", ""} <= set(table["slip"]) and table["fz_n"][-1] < -0.3


def test_forces_at_the_markers_sum_to_the_wrench(
    pressed: tuple[Path, list[gs.Frame]], recording: Path, tmp_path: Path
) -> None:
    path, frames = pressed
    plain, sensed = tmp_path / "plain", tmp_path / "forces"
    assert main(["export", str(path), "--to", "lerobot", str(plain), "--images", "none"]) == 0
    assert main(["export", str(path), "--to", "lerobot", str(sensed), "--images", "none", "--force"]) == 0
    tables = [parquet.read_table(folder / "data/chunk-000/file-000.parquet") for folder in (plain, sensed)]
    tactile = "observation.tactile."
    assert tactile + "force" not in tables[0].column_names
    wrenches = [np.array(table[tactile + "wrench"].to_pylist()) for table in tables]
    # Single precision; and the wrench was recorded in double precision.
    np.testing.assert_allclose(*wrenches, rtol=1e-6)
    force_n, full = (np.array(tables[1][tactile + name].to_pylist()) for name in ("force", "full"))
    displacement = np.array(tables[1][DISPLACEMENT].to_pylist())
    assert force_n.shape == (10, 625, 3) and full.shape == (10, 625, 6)
    # The squares are those of the stated pitch; the rest frame's pitch is measured within a thousandth of it.
    np.testing.assert_allclose(force_n.sum(axis=1), wrenches[1][:, :3], rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(full, np.concatenate([displacement, force_n], axis=2), atol=1e-5)
    assert np.array_equal(wrenches[1][0], np.zeros(6)) and frames[-1].wrench is not None
    np.testing.assert_allclose(wrenches[1][-1, :3], frames[-1].wrench.force_n, rtol=1e-6)
    with pytest.raises(ExportError, match="calibrate-force"):
        export_lerobot([recording], tmp_path / "no", task="grasp", forces=True)


def test_the_layout_for_foxglove_shows_what_is_recorded(pressed: tuple[Path, list[gs.Frame]]) -> None:
    """Its topics and fields are those of a recording; the host alone has contacts."""
    layout = json.loads((SCENE.parents[1] / "examples" / "foxglove" / "gelstereo.json").read_text())
    panels: set[str] = set()

    def collect(part: Any) -> None:
        if isinstance(part, str):
            panels.add(part)
        else:
            assert part["direction"] in ("row", "column")
            collect(part["first"])
            collect(part["second"])

    collect(layout["layout"])
    configs = layout["configById"]
    assert panels == set(configs)
    topics = {
        POINTS,
        LEFT,
        LEFT.replace("left", "right"),
        "/gelstereo/wrench",
        "/gelstereo/slip",
        "/gelstereo/frame",
    }
    messages = dict(_messages(pressed[0], topics))
    assert set(messages) == topics
    paths = [
        path["value"] for name, plot in configs.items() if name.startswith("Plot") for path in plot["paths"]
    ]
    paths += [raw["topicPath"] for name, raw in configs.items() if name.startswith("RawMessages")]
    for path in paths:
        topic, *fields = path.split(".")
        if topic == "/gelstereo/contact":
            continue
        found = messages[topic]
        for field in fields:
            found = getattr(found, field)
        assert isinstance(found, (float, str))
    images = {image["imageMode"]["imageTopic"] for name, image in configs.items() if name.startswith("Image")}
    cloud = configs["3D!markers"]["topics"][POINTS]["colorField"]
    assert images <= topics and cloud in [field.name for field in messages[POINTS].fields]


@pytest.mark.parametrize(("pitch_mm", "area_mm2"), [(0.9, 0.81), ([0.9, 0.9], 0.81), ([0.8, 1.2], 0.96)])
def test_a_marker_bears_the_traction_of_its_cell(pitch_mm: float | list[float], area_mm2: float) -> None:
    traction_kpa = np.array([[0.0, 0.0, -10.0], [2.0, 1.0, -20.0]])
    features = force_features(np.ones((2, 3)), traction_kpa, pitch_mm, np.ones(3), np.zeros(3))
    # 1 kPa on 1 mm2 is 1 mN.
    np.testing.assert_allclose(features["force"], traction_kpa * area_mm2 * 1e-3, rtol=1e-12)
    np.testing.assert_array_equal(features["full"], np.hstack([np.ones((2, 3)), features["force"]]))
    np.testing.assert_array_equal(features["wrench"], [1, 1, 1, 0, 0, 0])
