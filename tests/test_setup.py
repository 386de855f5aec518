"""`gelstereo setup`: from images of a simulated sensor to its sensor file, against the simulated truth."""

from __future__ import annotations

import copy
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from own_sensor import GEL, LAYERS, PEG, PEG_MM, PEG_RAD, press, true_rig, write_own_sensor

import gelstereo as gs
from gelstereo.cli.main import main
from gelstereo.setup import Plan, PlanError, Step, law, load_sensor, set_up
from gelstereo.setup.layers import over_plate_sigma_mm
from gelstereo.setup.plan import EXAMPLE
from gelstereo.setup.sensor import SensorFileError


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of the tutorial's sensor, and its plan."""
    folder = tmp_path_factory.mktemp("sensor")
    write_own_sensor(folder)
    (folder / "plan.toml").write_text(EXAMPLE)
    return folder


@pytest.fixture(scope="module")
def output(images: Path) -> Path:
    return images / "out"


@pytest.fixture(scope="module")
def steps(images: Path, output: Path) -> list[Step]:
    return set_up(Plan.load(images / "plan.toml"), output)


def test_every_step_of_a_good_sensor_is_good(steps: list[Step], output: Path) -> None:
    assert [step.name for step in steps] == ["cameras", "print", "layers", "rest", "presses"]
    assert [str(step) for step in steps if not step.is_good] == []
    page = (output / "report.html").read_text()
    assert "All steps are good." in page and "data:image/png" in page and "decay length" in page


def test_the_sensor_file_has_the_simulated_truth(steps: list[Step], output: Path) -> None:
    sensor = load_sensor(output / "sensor.toml")
    found = sensor.rig.layers
    assert found is not None and abs(found["gel_index"] - LAYERS["gel_index"]) < 0.01
    assert abs(found["gap_mm"] - LAYERS["gap_mm"]) < 0.1
    assert (sensor.gel["rows"], sensor.gel["cols"]) == (GEL["rows"], GEL["cols"])
    assert abs(sensor.gel["surface_mm"] - GEL["surface_mm"]) < 0.1
    assert abs(sensor.gel["dot_radius_mm"] - GEL["dot_radius_mm"]) < 0.03
    assert abs(sensor.gel["noise_levels"] - 2.0) < 0.5
    assert 0.001 < sensor.gel["point_sigma_mm"] < 0.02
    assert sensor.gel["decay_sigma_mm"] < 0.5 * sensor.gel["decay_mm"]


def test_a_part_is_localized_with_the_sensor_file_alone(
    steps: list[Step], images: Path, output: Path
) -> None:
    sensor = load_sensor(output / "sensor.toml")
    pipeline = gs.Pipeline(sensor.rig, sensor.params)
    for left, right in Plan.load(images / "plan.toml").presses.pairs:  # type: ignore[union-attr]
        frame = pipeline.process(*(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (left, right)))
    peg = gs.Template.from_mesh(images / "peg.stl", units="mm")
    truth = np.array(gs.geometry.se3_exp([*PEG_RAD, 0.0, 0.0, 0.0]))
    truth[:3, 3] = PEG_MM
    found = gs.localize(frame, peg, guess=truth, params=sensor.params)
    off_mm = np.asarray(found.t_sensor_object)[:3, 3] - PEG_MM
    # Along its axis, y of the sensor, the peg may slide.
    assert found.verdict == "fits" and np.abs(off_mm[[0, 2]]).max() < 0.1


def test_the_digital_twin_has_the_sensors_markers(steps: list[Step], output: Path) -> None:
    sensor = load_sensor(output / "sensor.toml")
    twin = gs.Simulator(sensor.scene())
    pair = twin.press()
    frame = gs.Pipeline(sensor.rig, sensor.params).process(pair.left, pair.right)
    real = gs.Pipeline(true_rig(), sensor.params)
    true = press(PEG, 33.0, PEG_MM[2], PEG_RAD).press()
    truth = real.process(true.left, true.right)
    assert np.abs(np.asarray(frame.points_mm) - truth.points_mm).max() < 0.25


def test_a_repeated_setup_runs_only_what_has_changed(steps: list[Step], images: Path, output: Path) -> None:
    lines: list[str] = []
    plan = Plan.load(images / "plan.toml")
    assert set_up(plan, output, lines.append) == steps
    assert not [line for line in lines if line.endswith("...")]
    # A damaged step is made anew, and what follows is taken again.
    (output / "steps" / "2-print.json").write_text("{")
    set_up(plan, output, lines.append)
    assert [line for line in lines if line.endswith("...")] == ["print ..."]


def test_a_measured_thickness_tells_the_depth_of_the_print(images: Path, tmp_path: Path) -> None:
    """The print is 5 mm from the plate."""
    plan = EXAMPLE.replace(
        "# [gel]\n# thickness_mm = 4.0\n# thickness_", "[gel]\nthickness_mm = 5.4\nthickness_"
    )
    (images / "measured.toml").write_text(plan)
    found = {step.name: step for step in set_up(Plan.load(images / "measured.toml"), tmp_path / "out")}
    gel = found["presses"].values["gel"]
    assert {"depth_mm", "thickness_mm"} <= set(gel["learned"])
    assert gel["thickness_mm"] == 5.4 and gel["thickness_sigma_mm"] == 0.02
    assert abs(gel["depth_mm"] - 0.4) < 3 * gel["depth_sigma_mm"]
    # Of that, the plate's own thickness is 0.05 mm.
    assert 0.03 < gel["depth_sigma_mm"] < 0.1
    lattice = load_sensor(tmp_path / "out" / "sensor.toml").params.to_dict()["lattice"]
    assert (lattice["depth_mm"], lattice["depth_sigma_mm"]) == (gel["depth_mm"], gel["depth_sigma_mm"])


@pytest.mark.parametrize("name", ["gap_mm", "gel_index", "plate_0_thickness_mm", "plate_0_index"])
def test_an_error_of_the_layers_moves_the_print_as_stated(name: str) -> None:
    rig, step = true_rig(), 1e-3
    layers = rig.layers
    assert layers is not None
    print_mm = np.array([[4.0, 0.0, GEL["surface_mm"]]])
    changed = copy.deepcopy(layers)
    held, key = (changed["plates"][0], name[8:]) if name.startswith("plate_0") else (changed, name)
    held[key] += step
    params = gs.Params.preset("balanced")
    found_mm = gs.triangulate(rig.with_layers(changed), *rig.project(print_mm), params)
    moved = found_mm[0, 2] - print_mm[0, 2]
    moved -= step * (name in ("gap_mm", "plate_0_thickness_mm"))
    pose = np.eye(4)
    pose[:3, 3] = print_mm[0]
    found = SimpleNamespace(
        values={name: held[key]}, covariance=np.array([[step**2]]), rig=rig, t_sensor_lattice=pose
    )
    assert over_plate_sigma_mm(found) == pytest.approx(abs(moved), rel=0.1)


def test_the_print_is_below_a_skin_whose_depth_is_given() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(4.0), np.arange(4.0)))
    skin = gs.RestSurface(np.column_stack([x, y, np.full(16, GEL["surface_mm"] + 0.4)]))
    assert law.over_plate(true_rig(), skin, 0.05, 0.4) == pytest.approx((5.0, 0.05))
    given = law.GelLength("depth_mm", 0.4, 0.04, False, "given")
    assert law.thickness_of((5.0, 0.03), given).value == pytest.approx(5.4)


def test_a_print_beyond_the_measured_thickness_is_doubted() -> None:
    depth, thickness = law.by_thickness((5.0, 0.05), (4.0, 0.02))
    assert not depth.learned and "1.00 mm beyond the gel's thickness" in depth.why
    assert (thickness.value, thickness.sigma, thickness.learned) == (4.0, 0.02, True)
    within, _ = law.by_thickness((5.0, 0.04), (4.95, 0.03))
    assert within.learned and within.value == 0.0 and within.sigma == pytest.approx(0.05)
    unknown, _ = law.by_thickness(None, (4.0, 0.02))
    assert not unknown.learned and "give [layers]" in unknown.why


def test_a_wrong_pitch_and_a_short_rest_are_doubted(images: Path, tmp_path: Path) -> None:
    text = EXAMPLE.replace("pitch_mm = 0.8 ", "pitch_mm = 0.84 ").replace("left/*", "left/0000")
    (images / "wrong.toml").write_text(text.replace("right/*", "right/0000").partition("[[boards]]")[0])
    found = {step.name: step for step in set_up(Plan.load(images / "wrong.toml"), tmp_path / "out")}
    assert found["cameras"].is_good and not found["layers"].is_good
    doubts = " ".join(found["rest"].doubts)
    assert "lattice.pitch_mm is 0.84" in doubts and "1 frames at rest do not show the noise" in doubts
    assert "In doubt: layers, gel at rest." in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[rest]", "[rests]"), "unknown key 'rests'"),
        (("pitch_mm = 0.8", "pitch_mm = -1"), r"pitch_mm in \[rest\] is -1; valid is a number above 0"),
        (('board = "9x6"', 'board = "nine"'), "'nine' is not a board"),
        (("square_mm = 2.0", ""), "square_mm is missing"),
        (("chessboard/left*", "nothing/left*"), r"left in \[cameras\]: .*nothing"),
        (("chessboard/left*.png", "gel/board_0.8_left.png"), "has 1 left and 12 right images"),
        (('preset = "balanced"', 'preset = "best"'), "preset is 'best'; valid are paper"),
        (("# [gel]", "[gel]\nthick_mm = 4.0"), r"\[gel\] has an unknown key 'thick_mm'"),
        (("# [gel]", "[gel]\nthickness_mm = 4.0"), r"thickness_sigma_mm in \[gel\] is None"),
        ((EXAMPLE.partition("# A part pressed")[2], "\n[gel]\nthickness_mm = 4.0"), r"give \[presses\] too"),
    ],
)
def test_a_plan_that_is_not_valid_is_named(images: Path, change: tuple[str, str], message: str) -> None:
    (images / "bad.toml").write_text(EXAMPLE.replace(*change))
    with pytest.raises(PlanError, match=message):
        Plan.load(images / "bad.toml")


def test_the_command_prints_a_plan_and_its_errors(
    images: Path, steps: list[Step], output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["setup", "--example"]) == 0 and capsys.readouterr().out == EXAMPLE
    assert main(["setup"]) == 2 and "needs a plan" in capsys.readouterr().err
    assert main(["setup", str(images / "none.toml")]) == 2 and "No such plan" in capsys.readouterr().err
    assert main(["setup", str(images / "plan.toml"), "--output", str(output)]) == 0
    assert "wrote" in capsys.readouterr().out
    other = images / "other.toml"
    other.write_text('preset = "balanced"\n')
    with pytest.raises(SensorFileError, match="has no 'rig', so it is no sensor file"):
        load_sensor(other)
