"""The gallery: every scene file, its page and its picture; and plans from Python."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from gelstereo import Scene, SceneError, simulate
from gelstereo.cli.main import main
from gelstereo.simulation import plan_record
from gelstereo_bench.reports.scenes import Exhibit, digest, draw, moments

REPOSITORY = Path(__file__).parents[1]
FILES = sorted((REPOSITORY / "scenes").glob("*.toml"))
PAGE = (REPOSITORY / "docs" / "scenes.md").read_text(encoding="utf-8")


def test_there_are_at_least_ten_scenes() -> None:
    assert len(FILES) >= 10


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_scene_gives_the_bits_of_the_manual(path: Path) -> None:
    exhibit = Exhibit.open(path)
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| [{path.stem}]"))
    frames = moments(exhibit.simulator)
    assert f"`{digest(frames)}`" in row, "python -m gelstereo_bench.reports.scenes writes the page"
    assert digest(moments(simulate(path))) == digest(frames)
    assert exhibit.text in PAGE
    assert (REPOSITORY / "docs" / "pictures" / f"scene-{path.stem}.jpg").is_file()


def test_a_picture_shows_image_and_motion() -> None:
    exhibit = Exhibit.open(REPOSITORY / "scenes" / "slip_ball.toml")
    picture = draw(exhibit, [exhibit.simulator[20]])
    assert picture.ndim == 3
    # The image is grey; heights below it are in colour.
    colourful = np.ptp(picture.astype(int), axis=2) > 60
    upper, lower = np.array_split(colourful, 2)
    assert upper.sum() == 0
    assert lower.sum() > 1000


def slip(time_s: float) -> float:
    """Mean motion along x of the markers that the ball holds, mm."""
    simulator = simulate(REPOSITORY / "scenes" / "slip_ball.toml")
    frame = simulator[round(30 * time_s)]
    motion = np.asarray(frame.points_mm) - simulator.press().points_mm
    return float(motion[np.asarray(frame.in_contact), 0].mean())


def test_the_gel_springs_back_when_the_ball_slips() -> None:
    before, after, again = slip(0.5), slip(0.6), slip(1.0)
    # It is dragged by 0.6 mm, keeps 0.3 mm, and is dragged to 0.6 mm again; some of those that the ball
    # touches now are new, and the gel's spread adds to both sides.
    assert before == pytest.approx(0.6, abs=0.12)
    assert after == pytest.approx(0.3, abs=0.12)
    assert again == pytest.approx(before, abs=0.12)


def test_the_peg_leaves_nothing_behind_when_it_is_grasped_again() -> None:
    simulator = simulate(REPOSITORY / "scenes" / "regrasp_peg.toml")
    rest = simulator.press()
    np.testing.assert_array_equal(simulator[33].points_mm, rest.points_mm)  # 1.1 s: in the air
    assert simulator[20].in_contact.any() and simulator[-1].in_contact.any()


ASKED = {"kind": "positions", "tolerance_px": 0.05}


def test_a_plan_says_what_is_computed() -> None:
    scene = Scene.load(REPOSITORY / "scenes" / "press_sphere.toml")
    whole = simulate(scene)
    assert [effect.name for effect in whole.plan.effects if effect.on] == [
        "shoulder", "spread", "defocus", "sensor_noise", "ellipse_bias",
    ]  # fmt: skip
    asked = simulate(scene.replace(asked=ASKED))
    off = [effect for effect in asked.plan.effects if not effect.on]
    assert {effect.name for effect in off} == {"defocus", "sensor_noise"}
    assert all(effect.bound_px == 0.0 and "within the tolerance" in effect.why for effect in off)
    assert asked.plan.left_out == 0.0
    assert 0.0 < asked.plan.cost_ns < whole.plan.cost_ns
    assert "positions within 0.05 px" in str(asked.plan)
    np.testing.assert_array_equal(asked[20].left_dots.centres_px, whole[20].left_dots.centres_px)
    plain = scene.replace({"effects": {"defocus": None, "sensor_noise": None}})
    np.testing.assert_array_equal(asked[20].left, simulate(plain)[20].left)
    assert asked.plan.scene.to_dict() == plain.to_dict()


def test_a_plan_can_be_json() -> None:
    scene = Scene().replace(effects={"dropped_frames": {"rate": 0.1}, "grain": {}}, asked=ASKED)
    record = json.loads(json.dumps(plan_record(simulate(scene).plan), allow_nan=False))
    dropped = next(effect for effect in record["effects"] if effect["name"] == "dropped_frames")
    assert dropped["on"] and dropped["bound_px"] is None


def test_the_command_writes_points_where_points_are_asked(tmp_path: Path) -> None:
    scene = Scene.load(REPOSITORY / "scenes" / "press_sphere.toml")
    scene.replace(asked={"kind": "points", "tolerance_um": 0.0}).save(tmp_path / "scene.toml")
    out = tmp_path / "out"
    assert main(["simulate", str(tmp_path / "scene.toml"), "--output", str(out), "--frames", "20"]) == 0
    with np.load(out / "truth.npz") as truth:
        assert set(truth) == {
            "index", "time_s", "points_mm", "indentation_mm", "in_contact", "t_sensor_object",
        }  # fmt: skip
        np.testing.assert_array_equal(truth["points_mm"][0], simulate(scene)[20].points_mm)
    assert not (out / "left").exists()


def test_switches_are_checked() -> None:
    with pytest.raises(SceneError, match="nothing is asked"):
        simulate({"effects": {"grain": {}}, "switches": {"grain": "auto"}})
    with pytest.raises(SceneError, match="list it under"):
        simulate({"switches": {"grain": "on"}})
    with pytest.raises(SceneError, match="tolerance_um"):
        simulate({"asked": {"kind": "points", "tolerance_px": 1.0}})


def test_the_command_prints_and_writes_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = REPOSITORY / "scenes" / "marker_field.toml"
    assert main(["simulate", str(path), "--output", str(tmp_path), "--frames", "0"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"grain +0 px +off", text)
    record = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert [effect["on"] for effect in record["effects"] if effect["name"] == "grain"] == [False]
    # It asks for positions: no images.
    assert not (tmp_path / "left").exists()
    with np.load(tmp_path / "truth.npz") as truth:
        np.testing.assert_array_equal(truth["left_px"][0], simulate(path)[0].left_px)
    # What was simulated had no distortion, and the rig beside it says so.
    assert "distortion = [0.0, 0.0, 0.0, 0.0, 0.0]" in (tmp_path / "rig.toml").read_text(encoding="utf-8")
