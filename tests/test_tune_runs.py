"""`gelstereo tune` on simulated frames and recordings, and its command.

Times come from a counter in place of a clock, so that no test depends on the machine.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelstereo as gs
from gelstereo.cli.main import main
from gelstereo.setup.sensor import Sensor, sensor_text
from gelstereo.tune import (
    Goal,
    Part,
    TuneError,
    laboratory_of,
    recorded_takes,
    simulated_takes,
    tune,
)
from gelstereo.tune.command import scene_part
from gelstereo.tune.measure import outcome_of
from gelstereo.tune.predict import base_settings, settings_to_measure

SCENES = Path(__file__).parents[1] / "scenes"
#: A press of a peg, 16 frames.
PEG = gs.Scene.load(SCENES / "grasp_cylinder.toml").replace({"frame_rate_hz": 10.0})


class Clock:
    """Each reading is a microsecond later."""

    def __init__(self) -> None:
        self.readings = 0

    def __call__(self) -> int:
        self.readings += 1
        return 1000 * self.readings


# Simulated frames


@pytest.fixture(scope="module")
def peg() -> Part:
    return Part(scene_part(SCENES / "grasp_cylinder.toml").with_symmetries())


def test_sensing_is_tuned_against_the_truth(tmp_path: Path) -> None:
    clock = Clock()
    takes = simulated_takes(PEG, 3)
    laboratory = laboratory_of(takes, cache=tmp_path / "kept.json", clock=clock)
    tuned = tune(laboratory, Goal(budget_ms=1.0))
    assert tuned.is_reached and tuned.is_confirmed and tuned.is_simulated
    # Every frame takes a microsecond, so the most accurate settings are within the budget.
    assert tuned.outcome.time_ms == pytest.approx(1e-3)
    assert "fit" in tuned.setting.detect.name and tuned.setting.register is None
    everything = [
        outcome_of(each)
        for each in laboratory.measure(
            settings_to_measure(base_settings(laboratory.base, False)[0]), 2
        ).values()
    ]
    assert tuned.outcome.height_um <= 1.01 * min(each.height_um for each in everything)
    # A second laboratory has the same figures without a measurement.
    readings = clock.readings
    again = tune(laboratory_of(takes, cache=tmp_path / "kept.json", clock=clock), Goal(budget_ms=1.0))
    assert str(again) == str(tuned) and clock.readings == readings


def test_height_errors_are_those_of_the_pipeline() -> None:
    takes = simulated_takes(PEG, 2)
    laboratory = laboratory_of(takes, clock=Clock())
    setting = base_settings(laboratory.base, False)[0]
    [figures] = laboratory.measure([setting], 1)[setting]
    pipeline = gs.Pipeline(takes.rig, setting.params(laboratory.base))
    squared = []
    for shot in takes.tuning[0].shots:
        frame = pipeline.process(shot.left, shot.right)
        seen = frame.state == gs.MarkerState.SEEN
        squared.append(np.mean((frame.points_mm - shot.points_mm)[seen, 2] ** 2))
    assert figures.height_um2 == pytest.approx(1e6 * np.mean(squared))


def test_a_part_is_registered_from_guesses(peg: Part) -> None:
    laboratory = laboratory_of(simulated_takes(PEG, 2), part=peg, clock=Clock())
    setting = base_settings(laboratory.base, True)[0]
    [figures] = laboratory.measure([setting], 1)[setting]
    assert figures.trials == 24 and figures.successes == 24
    # The peg is found to a fraction of a marker's depth error of some 6 um, as it rests on tens of markers.
    assert 0.0 < figures.pose_um2 < figures.height_um2 * 4.0  # type: ignore[operator]
    strict = replace(peg, tolerance_mm=1e-6)
    [figures] = laboratory_of(simulated_takes(PEG, 2), part=strict, clock=Clock()).measure([setting], 1)[
        setting
    ]
    assert figures.successes == 0 and figures.pose_um2 == pytest.approx(1e-6)


def test_a_part_that_touches_nothing_is_refused(peg: Part) -> None:
    away = [{**key, "position_mm": [4.0, 0.0, 40.0]} for key in PEG.to_dict()["trajectory"]]
    with pytest.raises(TuneError, match="touches the gel in no frame of the scene"):
        laboratory_of(simulated_takes(PEG.replace({"trajectory": away}), 2), part=peg, clock=Clock())


def test_an_interrupted_measurement_keeps_finished_takes(tmp_path: Path) -> None:
    class Impatient(Clock):
        def __call__(self) -> int:
            if self.readings >= 40:
                raise KeyboardInterrupt
            return super().__call__()

    takes, kept = simulated_takes(PEG, 3), tmp_path / "kept.json"
    setting = base_settings(gs.Params.preset("balanced"), False)[0]
    with pytest.raises(KeyboardInterrupt):
        laboratory_of(takes, cache=kept, clock=Impatient()).measure([setting], 2)
    assert list(json.loads(kept.read_text())["values"]) == [f"0: {setting}"]
    clock = Clock()
    laboratory_of(takes, cache=kept, clock=clock).measure([setting], 2)
    assert clock.readings == 2 * len(takes.tuning[1].shots)


def test_a_setting_that_cannot_sense_is_never_chosen() -> None:
    takes = simulated_takes(PEG, 2)
    blind = gs.Params.preset("balanced").replace({"lattice.rows": 7, "lattice.cols": 9})
    with pytest.raises(TuneError, match="no way of detection can sense"):
        tune(laboratory_of(takes, blind, clock=Clock()), Goal(budget_ms=1.0))


# Recordings


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor file, a recording and a folder of images of it."""
    folder = tmp_path_factory.mktemp("cell")
    simulator = gs.Simulator(PEG)
    gel = PEG.to_dict()["gel"]
    gel = {key: gel[key] for key in ("rows", "cols", "pitch_mm", "dot_radius_mm", "surface_mm", "centre_mm")}
    gel |= {"noise_levels": 2.0, "point_sigma_mm": 0.005}
    (folder / "sensor.toml").write_text(sensor_text(PEG.rig, "balanced", {}, gel))
    for view in ("left", "right"):
        (folder / "press" / view).mkdir(parents=True)
    for frame in simulator:
        for view in ("left", "right"):
            cv2.imwrite(str(folder / "press" / view / f"{frame.index}.png"), getattr(frame, view))
    PEG.save(folder / "peg.toml")
    words = ["live", "--scene", folder / "peg.toml", "--frames", "16", "--show", "none", "--rate-hz", "1000"]
    assert main([*map(str, words), "--record", str(folder / "run.mcap")]) == 0
    return folder


def sensor_of(cell: Path) -> Sensor:
    from gelstereo.setup import load_sensor

    return load_sensor(cell / "sensor.toml")


def test_a_recording_and_its_folder_of_images_are_the_same_takes(cell: Path) -> None:
    both = [recorded_takes(cell / name, sensor_of(cell), 12) for name in ("run.mcap", "press")]
    assert [len(takes.tuning) for takes in both] == [2, 2] and len(both[0].held_out) == 1
    for one, other in zip(*(takes.tuning + takes.held_out for takes in both), strict=True):
        assert len(one.shots) == len(other.shots)
        for a, b in zip(one.shots, other.shots, strict=True):
            np.testing.assert_array_equal(a.left, b.left)
    # All frames are used once, but for that of rest.
    used = sum(len(take.shots) - 1 for take in (*both[0].tuning, *both[0].held_out))
    assert used == 15


def test_a_recording_is_tuned_by_its_covariances(cell: Path) -> None:
    takes = recorded_takes(cell / "press", sensor_of(cell), 12)
    laboratory = laboratory_of(takes, sensor_of(cell).params, clock=Clock())
    truth = laboratory_of(simulated_takes(PEG, 2), clock=Clock())
    for setting in settings_to_measure(base_settings(laboratory.base, False)[0])[::2]:
        stated = outcome_of(laboratory.measure([setting], 2)[setting])
        true = outcome_of(truth.measure([setting], 1)[setting])
        assert 0.7 * true.height_um < stated.height_um < 1.4 * true.height_um


def test_the_part_of_a_recording_is_found_from_a_guess(cell: Path, peg: Part) -> None:
    takes = recorded_takes(cell / "press", sensor_of(cell), 12)
    truth = np.array(gs.Simulator(PEG)[8].t_sensor_object)
    guess = truth @ gs.geometry.se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])
    part = replace(peg, guess=guess)
    laboratory = laboratory_of(takes, part=part, clock=Clock())
    setting = base_settings(laboratory.base, True)[0]
    found = laboratory.measure([setting], laboratory.takes)[setting]
    assert all(each.trials and each.successes == each.trials for each in found)
    with pytest.raises(TuneError, match="found in too few takes"):
        laboratory_of(takes, part=replace(peg, guess=np.eye(4)), clock=Clock())


# The command


def test_the_command_writes_settings_that_can_be_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    PEG.save(tmp_path / "peg.toml")
    words = ["tune", "--scene", "peg.toml", "--takes", "3", "--cache", "kept", "--output", "out/tuned.toml"]
    words = [str(tmp_path / word) if "." in word or word == "kept" else word for word in words]
    assert main([*words, "--error-um", "1000"]) in (0, 1)
    text = (tmp_path / "out" / "tuned.toml").read_text()
    assert "# goal: at most 1000 um" in text and "held out" in text and "gelstereo" in text
    assert "soft_threshold" in text
    gs.Params.load(tmp_path / "out" / "tuned.toml")
    # The same frames and another goal: nothing is measured again but the new candidates.
    assert main([*words, "--error-um", "0.001"]) == 1
    assert "instead of at most 0.001" in capsys.readouterr().out
    # Another scene of the same name makes what is kept stale.
    PEG.replace({"seed": 77}).save(tmp_path / "peg.toml")
    assert main([*words, "--error-um", "1000"]) == 2
    assert "are stale: frames" in capsys.readouterr().err
    assert main([*words, "--error-um", "1000", "--measure-again"]) in (0, 1)


def test_a_scene_is_tuned_on_the_users_sensor(tmp_path: Path) -> None:
    """The part of the scene presses the gel of the sensor, and its cameras see it."""
    gel = {"rows": 17, "cols": 19, "pitch_mm": 1.1, "dot_radius_mm": 0.25}
    gel |= {key: PEG.to_dict()["gel"][key] for key in ("surface_mm", "centre_mm")}
    gel |= {"noise_levels": 4.0, "point_sigma_mm": 0.01}
    rig = gs.Rig.parallel((640, 480), 500.0, 6.0)
    lattice = {"lattice.rows": 17, "lattice.cols": 19, "lattice.pitch_mm": 1.1}
    (tmp_path / "sensor.toml").write_text(sensor_text(rig, "fast", lattice, gel))
    PEG.save(tmp_path / "peg.toml")
    words = [
        "tune",
        "--scene",
        "peg.toml",
        "--sensor",
        "sensor.toml",
        "--cache",
        "kept",
        "--output",
        "out.toml",
    ]
    words = [str(tmp_path / word) if "." in word or word == "kept" else word for word in words]
    assert main([*words, "--takes", "2", "--error-um", "1000"]) in (0, 1)
    tuned = gs.Params.load(tmp_path / "out.toml").to_dict()["lattice"]
    assert (tuned["rows"], tuned["cols"], tuned["pitch_mm"]) == (17, 19, 1.1)
    sensor = sensor_of(tmp_path)
    shots = simulated_takes(PEG, 2, sensor=sensor).tuning[0].shots
    frames = [gs.Pipeline(rig, sensor.params).process(shots[0].left, shots[0].right)]
    assert (frames[0].rows, frames[0].cols) == (17, 19)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scene", "grasp_cylinder.toml"], "there is no goal"),
        (["--scene", "grasp_cylinder.toml", "--success", "99"], "needs the part"),
        (["--scene", "grasp_cylinder.toml", "--budget-ms", "-1"], "valid is a finite number above 0"),
        (["--scene", "marker_field.toml", "--budget-ms", "1"], "tuning needs one that has images"),
        (["--recording", "run.mcap", "--budget-ms", "1"], "needs its sensor"),
        (["--recording", "run.mcap", "--budget-ms", "1", "--part", "own"], "only a scene has a part"),
    ],
)
def test_bad_input_is_refused(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(SCENES / word) if word.endswith(".toml") else word for word in words]
    assert main(["tune", *words]) == 2
    assert message in capsys.readouterr().err


def test_a_recording_of_another_sensor_is_refused(cell: Path) -> None:
    other = replace(sensor_of(cell), rig=gs.Scene.preset("1280x720-25").rig)
    with pytest.raises(TuneError, match="640x480 pixels and the sensor of 1280x720"):
        recorded_takes(cell / "press", other, 12).tuning[0].shots  # noqa: B018
