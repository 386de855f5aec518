"""Stepping through recordings of the host: pictures in a folder, Rerun, and a window where there is one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_recording_readers import host_binary
from test_run_report import Tree

from gelstereo.cli import main
from gelstereo.geometry import shape_mesh
from gelstereo.view.edges import feature_edges_mm
from gelstereo.view.messages import RecordingError
from gelstereo.view.moment import Part
from gelstereo.view.step_window import step_after
from gelstereo.view.steps import Step, Steps, notes_of, outcome_in_words

STAGES = ["rest", "close", "localize", "align", "insert", "retreat"]
#: The time that a program of others may take on a busy machine.
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def steps(host_run: tuple[Path, dict]) -> list[Step]:
    return list(Steps(host_run[0]))


def test_there_is_a_step_for_each_stage_that_senses(steps: list[Step], host_run: tuple[Path, dict]) -> None:
    assert [step.stage for step in steps] == STAGES
    assert [step.number for step in steps] == list(range(len(STAGES)))
    frames = {stage["stage"]: stage["frames"] for stage in host_run[1]["stages"]}
    ends = np.cumsum([frames[name] for name in STAGES]) - 1
    assert [step.index for step in steps] == list(ends)


def test_a_step_has_what_was_known_then(steps: list[Step], host_run: tuple[Path, dict]) -> None:
    summary = host_run[1]
    assert [step.t_sensor_object is not None for step in steps] == [False, False, True, True, True, False]
    localized = summary["localized"]
    np.testing.assert_allclose(steps[2].t_sensor_object, localized["t_sensor_object"], atol=1e-9)
    assert steps[2].free == tuple(localized["free"])
    assert [step.events for step in steps if step.events] == [("trigger: grasp",), ("trigger: insertion",)]
    assert [step.outcome for step in steps[:-1]] == [""] * (len(STAGES) - 1)
    outcome = summary["outcome"]
    assert steps[-1].outcome == (
        f"inserted: depth {outcome['depth_mm']:.2f} mm, within {outcome['within_mm']:.2f} mm"
    )
    assert notes_of(steps[-1])[0] == f"ended: {steps[-1].outcome}"


def test_motion_in_a_picture_counts_from_the_reference_of_the_stage(
    steps: list[Step], host_run: tuple[Path, dict]
) -> None:
    walked = Steps(host_run[0])
    for step in steps:
        moment = walked.moment(step)
        seen = moment.state == 0
        moved_px = np.linalg.norm(moment.left_px - moment.reference_px, axis=1)[seen].mean()
        # Points are triangulated from both views and projected back, which moves noise of 0.03 px about.
        assert moved_px == pytest.approx(step.motion_px, abs=0.05), step.stage


@pytest.mark.parametrize("every", [1, 7, 1000])
def test_every_so_many_frames_and_always_the_last(
    every: int, steps: list[Step], host_run: tuple[Path, dict]
) -> None:
    found = [step.index for step in Steps(host_run[0], every)]
    last = steps[-1].index
    assert last is not None and found == sorted({*range(0, last + 1, every), last})
    events = [event for step in Steps(host_run[0], every) for event in step.events]
    assert events == ["trigger: grasp", "trigger: insertion"]


def test_a_recording_that_was_cut_off_has_the_steps_before_the_cut(
    tmp_path: Path, steps: list[Step], host_run: tuple[Path, dict]
) -> None:
    whole, cut = host_run[0].read_bytes(), tmp_path / "cut.mcap"
    for share in (0.2, 0.5, 0.9):
        cut.write_bytes(whole[: int(share * len(whole))])
        found = list(Steps(cut))
        assert [step.stage for step in found] == STAGES[: len(found)]
        assert [step.index for step in found[:-1]] == [step.index for step in steps[: len(found) - 1]]
        assert found[-1].outcome == ""


def test_without_a_task_each_frame_has_the_pose_of_its_own_time(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "sense.mcap"
    command = [host_binary(), "sense", "--frames", "60", "--record", str(path)]
    subprocess.run(command, capture_output=True, text=True, check=True)
    with path.open("rb") as stream:
        posed = {m.publish_time for _, _, m in make_reader(stream).iter_messages(topics=["/gelstereo/pose"])}
    found = list(Steps(path, 1))
    assert len(found) == 60 and 0 < len(posed) < 60
    assert {step.time_ns for step in found if step.t_sensor_object is not None} == posed


def test_what_has_no_steps_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        list(Steps(tmp_path / "text.mcap"))
    with pytest.raises(FileNotFoundError):
        list(Steps(tmp_path / "missing.mcap"))


def test_a_folder_gets_pictures_and_a_page(tmp_path: Path, host_run: tuple[Path, dict]) -> None:
    folder = tmp_path / "out" / "steps"
    assert main(["view", str(host_run[0]), "--steps", str(folder)]) == 0
    page = Tree((folder / "index.html").read_text()).root
    shown = [image.attributes["src"] for image in page.find_all("img")]
    assert shown == [f"{number:03d}_{name}.png" for number, name in enumerate(STAGES)]
    assert all(image.attributes["alt"] for image in page.find_all("img"))
    pictures = [cv2.imread(str(folder / name)) for name in shown]
    assert len({picture.shape for picture in pictures}) == 1, "pictures of one size can be flipped through"
    green = (np.abs(pictures[-1].astype(int) - (90, 220, 90)).max(axis=2) < 30).sum()
    assert green > 200, "the part's edges"
    assert "The run ended: inserted" in page.text
    # A later, shorter look leaves nothing of the earlier one.
    assert main(["view", str(host_run[0]), "--steps", str(folder), "--every", "1000"]) == 0
    assert len(list(folder.glob("*.png"))) == 2


def test_a_folder_of_other_files_is_left_alone(
    tmp_path: Path, host_run: tuple[Path, dict], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "000_mine.png").write_text("mine")
    assert main(["view", str(host_run[0]), "--steps", str(tmp_path)]) == 2
    assert "valid is a new or an empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["000_mine.png"]


def test_rerun_reads_what_was_logged(tmp_path: Path, host_run: tuple[Path, dict]) -> None:
    pytest.importorskip("rerun", reason="PyPI's rerun-sdk is not installed")
    path = tmp_path / "run.rrd"
    assert main(["view", str(host_run[0]), "--rerun", str(path)]) == 0

    def rrd(*words: str) -> str:
        command = [sys.executable, "-m", "rerun", "rrd", *words, str(path)]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S).stdout

    rrd("verify")
    printed = rrd("print")
    for entity in ("/image/left", "/image/left/markers", "/image/left/part", "/sensor/gel", "/sensor/part"):
        assert entity in printed, entity
    assert "/events" in printed and "/step" in printed


def test_without_rerun_the_extra_is_named(
    tmp_path: Path,
    host_run: tuple[Path, dict],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for module in ("step_rerun", "rerun_stream"):
        monkeypatch.delitem(sys.modules, f"gelstereo.view.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", str(host_run[0]), "--rerun", str(tmp_path / "run.rrd")]) == 2
    assert "pip install 'gelstereo[rerun]'" in capsys.readouterr().err


def test_without_a_display_the_folder_is_named(
    host_run: tuple[Path, dict], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(host_run[0]), "--window"]) == 2
    assert "use --steps FOLDER" in capsys.readouterr().err
    assert main(["view", str(host_run[0]), "--rerun"]) == 2
    assert "--rerun FILE" in capsys.readouterr().err


def test_steps_are_those_of_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path), "--steps", str(tmp_path / "out")]) == 2
    assert "steps need a recording" in capsys.readouterr().err


@given(st.integers(-1, 3_000_000), st.integers(1, 50), st.data())
def test_keys_never_leave_the_recording(key: int, count: int, data: st.DataObject) -> None:
    shown = data.draw(st.integers(0, count - 1))
    number = step_after(key, shown, count)
    assert number is None or 0 <= number < count
    assert step_after(65363, shown, count) == min(shown + 1, count - 1)
    assert step_after(65361, shown, count) == max(shown - 1, 0)


@settings(max_examples=15)
@given(st.floats(-8, 8), st.floats(-8, 8), st.floats(25, 60), st.floats(2, 8))
def test_the_outline_of_a_ball_is_where_rays_touch_it(x: float, y: float, z: float, radius: float) -> None:
    centre = np.array([x, y, z])
    pose = np.eye(4)
    pose[:3, 3] = centre
    part = Part.located(*shape_mesh({"kind": "sphere", "radius_mm": radius}, 0.01), pose)
    edges = feature_edges_mm(part).reshape(-1, 3)
    rays = edges / np.linalg.norm(edges, axis=1)[:, None]
    distance = float(np.linalg.norm(centre))
    angles = np.arccos(np.clip(rays @ centre / distance, -1.0, 1.0))
    # A flattened ball's outline zigzags by a facet, the share 0.1 of the radius.
    assert np.abs(angles - np.arcsin(radius / distance)).max() < 0.1 * radius / distance
    assert np.ptp(np.arctan2(rays[:, 1] - y / z, rays[:, 0] - x / z)) > 5.5, "it goes all the way round"


def test_outcomes_in_words() -> None:
    assert outcome_in_words({"kind": "interrupted", "stage": "close"}) == "interrupted: stage close"
    assert outcome_in_words({}) == "unknown"
