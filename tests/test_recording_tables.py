"""A recording as tables for polars and pandas: the same figures as the run's own summary and the viewer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gelstereo.geometry import se3_exp
from gelstereo.recordings import Recording, RecordingError, load_recording
from gelstereo.view.steps import Steps


@pytest.fixture(scope="module")
def recording(host_run: tuple[Path, dict]) -> Recording:
    return load_recording(host_run[0])


def test_there_is_a_row_for_each_frame(recording: Recording, host_run: tuple[Path, dict]) -> None:
    table = recording.frame_table()
    assert {len(column) for column in table.values()} == {len(recording)}
    for stage in host_run[1]["stages"]:
        assert np.count_nonzero(table["stage"] == stage["stage"]) == stage["frames"]
    np.testing.assert_array_equal(table["seen"] + table["held"] + table["lost"], 625)
    assert table["time_s"][0] == 0.0 and (np.diff(table["time_ns"]) > 0).all()
    assert not table["error"].any()


def test_the_pose_is_that_of_the_run(recording: Recording, host_run: tuple[Path, dict]) -> None:
    table = recording.frame_table()
    [row] = np.flatnonzero(np.isfinite(table["x_mm"]))
    pose = host_run[1]["localized"]["t_sensor_object"]
    np.testing.assert_allclose(recording.t_sensor_object[row], pose, atol=1e-9)
    turn = se3_exp([table[f"r{axis}_rad"][row] for axis in "xyz"] + [0.0, 0.0, 0.0])[:3, :3]
    np.testing.assert_allclose(turn, np.array(pose)[:3, :3], atol=1e-9)
    sigma_mm = np.array([table[f"sigma_{axis}_mm"][row] for axis in "xyz"])
    # The peg slides along its axis: there the standard deviation is the prior of 0.6 mm.
    axis = np.array(pose)[:3, 2]
    assert np.hypot.reduce(sigma_mm) == pytest.approx(0.6, abs=0.02)
    assert np.argmax(sigma_mm) == np.argmax(np.abs(axis))


def test_markers_are_those_that_the_viewer_draws(recording: Recording, host_run: tuple[Path, dict]) -> None:
    table = recording.marker_table()
    last = list(Steps(host_run[0]))[-1]
    rows = table["frame"] == len(recording) - 1
    np.testing.assert_array_equal(
        np.stack([table[f"{axis}_mm"][rows] for axis in "xyz"]), last.cloud.points_mm.T
    )
    np.testing.assert_array_equal(
        table["row"][rows] * last.cloud.cols + table["col"][rows], table["marker"][rows]
    )
    np.testing.assert_array_equal(table["salient"][rows], last.cloud.salient)


def test_polars_takes_the_tables(recording: Recording) -> None:
    polars = pytest.importorskip("polars")
    frames, markers = polars.DataFrame(recording.frame_table()), polars.DataFrame(recording.marker_table())
    assert frames.height == len(recording) and markers.height == 625 * len(recording)
    deepest = markers.group_by("frame", maintain_order=True).agg(polars.col("indentation_mm").max())
    np.testing.assert_allclose(deepest["indentation_mm"].clip(lower_bound=0.0), frames["max_indentation_mm"])


def test_a_truncated_recording_has_the_frames_before_its_end(
    host_run: tuple[Path, dict], tmp_path: Path
) -> None:
    data = host_run[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    assert 0 < len(load_recording(cut)) < len(load_recording(host_run[0]))


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "text.mcap"
    other.write_text("nothing of a sensor")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        load_recording(other)
    with pytest.raises(FileNotFoundError):
        load_recording(tmp_path / "missing.mcap")


def test_a_frame_that_could_not_be_sensed_has_its_error(host_run: tuple[Path, dict]) -> None:
    from gelstereo.recordings.runs import _Walk
    from gelstereo.view.mcap_file import Recorded

    text = json.dumps({"error": "3 of 625 markers found"}).encode() + b"\0"
    message = b"\0\1\0\0" + len(text).to_bytes(4, "little") + text
    walk = _Walk()
    walk.take(Recorded("/gelstereo/frame", 5, 5, message))
    table = Recording(host_run[0], walk.sensed).frame_table()
    assert (table["error"][0], table["index"][0], table["seen"][0]) == ("3 of 625 markers found", -1, 0)
    assert np.isnan([table["motion_px"][0], table["max_indentation_mm"][0], table["x_mm"][0]]).all()
