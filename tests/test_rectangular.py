"""Prints whose rows and columns have different pitches: sensed, checked, calibrated and located."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from test_scattered import BALL_MM, PRESS_MM, RADIUS_MM, SURFACE_MM, pressed

import gelstereo as gs
from gelstereo.calibrate import CalibrationError, SeatedFrame, calibrate_layers
from gelstereo.setup import Sensor

ROWS, COLS = 13, 15
#: Pitches along rows and along columns. Labelling takes ratios up to about 1.8.
PITCHES = [(0.9, 1.44), (1.3, 0.8), (1.0, 1.25), (1.0, 1.0)]


def rest_mm(pitch_mm: tuple[float, float]) -> np.ndarray:
    x_mm = pitch_mm[0] * (np.arange(COLS) - 0.5 * (COLS - 1)) + 4.0
    y_mm = pitch_mm[1] * (np.arange(ROWS) - 0.5 * (ROWS - 1))
    y_mm, x_mm = np.meshgrid(y_mm, x_mm, indexing="ij")
    return np.column_stack([x_mm.ravel(), y_mm.ravel(), np.full(ROWS * COLS, SURFACE_MM)])


def sensor(pitch_mm: tuple[float, float] = (1.0, 1.0)) -> gs.Simulator:
    gel = {"rows": ROWS, "cols": COLS, "pitch_mm": list(pitch_mm), "dot_radius_mm": 0.2}
    return gs.Simulator(
        gs.Scene().replace({"gel": gel, "effects.defocus": {}, "effects.sensor_noise.sigma_levels": 1.5})
    )


@pytest.fixture(scope="module")
def ball() -> gs.Template:
    return gs.Template.from_mesh(trimesh.creation.icosphere(5, RADIUS_MM), units="mm", spacing_mm=0.5)


@pytest.mark.parametrize("pitch_mm", PITCHES)
def test_a_ball_on_a_rectangular_print_is_sensed_and_located(
    pitch_mm: tuple[float, float], ball: gs.Template
) -> None:
    simulator, rest = sensor(), rest_mm(pitch_mm)
    np.testing.assert_allclose(sensor(pitch_mm).press().points_mm, rest, atol=1e-12)
    params = gs.Params.preset("balanced").replace({"lattice.pitch_mm": list(pitch_mm)})
    pipeline = gs.Pipeline(gs.Scene().rig, params)
    squares = []
    for k in range(7):
        truth = pressed(rest, k / 6)
        drawn = simulator.render_points(truth, frame=k)
        frame = pipeline.process(drawn.left, drawn.right)
        assert (frame.rows, frame.cols) == (ROWS, COLS)
        off_mm = frame.points_mm - truth
        seen = frame.state == gs.MarkerState.SEEN
        assert seen.mean() > 0.98 and np.abs(off_mm).max() < 0.05
        squares.append(np.einsum("ni,nij,nj->n", off_mm, np.linalg.inv(frame.covariance_mm2), off_mm)[seen])
    assert 0.4 < np.concatenate(squares).mean() / 3 < 1.6
    check = pipeline.pitch_check
    assert check is not None and not check.is_off and check.expected_mm == pitch_mm
    assert np.abs(np.subtract(check.measured_mm, pitch_mm)).max() < 5 * max(check.sigma_mm)
    away_mm = np.hypot(*(rest[:, :2] - BALL_MM[:2]).T)
    # The drawn surface leaves the ball where its height is half of the deepest.
    touch_mm = np.sqrt(RADIUS_MM**2 - (RADIUS_MM - 0.5 * PRESS_MM) ** 2)
    # Markers resolve that border to half a pitch.
    beyond_mm = touch_mm + 0.5 * min(pitch_mm)
    assert frame.salient[away_mm < touch_mm].all() and not frame.salient[away_mm > beyond_mm].any()
    guess = np.eye(4)
    guess[:3, 3] = BALL_MM + [0.5, -0.4, 0.3]
    pose = gs.localize(frame, ball, guess=guess, params=params)
    # The drawn surface follows no gel's law, which the registration assumes beside the ball.
    assert pose.converged and np.linalg.norm(pose.t_sensor_object[:3, 3] - BALL_MM) < 0.05


def test_a_square_setting_of_a_rectangular_print_is_warned_of() -> None:
    drawn = sensor((1.0, 1.25)).press()
    pipeline = gs.Pipeline(gs.Scene().rig, gs.Params().replace({"lattice.pitch_mm": 1.0}))
    with pytest.warns(gs.PitchWarning, match=r"1\.2[45]\d* ± .* along columns .* \+0\.\d % and \+25\.\d %"):
        pipeline.process(drawn.left, drawn.right)


def test_a_setting_is_one_number_or_two() -> None:
    params = gs.Params().replace({"lattice.pitch_mm": [1.0, 1.25]})
    assert params.to_dict()["lattice"]["pitch_mm"] == [1.0, 1.25]
    assert gs.Params.from_toml(params.to_toml()) == params
    # Equal ones are a square print.
    assert gs.Params().replace({"lattice.pitch_mm": [0.9, 0.9]}) == gs.Params()
    for wrong in ([1.0], [1.0, 1.0, 1.0], "wide", [1.0, -1.0]):
        with pytest.raises(gs.ParamsError, match="pitch_mm"):
            gs.Params().replace({"lattice.pitch_mm": wrong})


def test_layers_are_found_with_a_rectangular_print() -> None:
    layers = {"normal": [0.0, 0.0, 1.0], "gap_mm": 20.0, "gel_index": 1.41, "plates": []}
    true, pitch_mm = gs.Scene().rig.with_layers(layers), (0.9, 1.2)
    rest = rest_mm(pitch_mm)
    rng = np.random.default_rng(0)
    rows, cols = (place.ravel() for place in np.mgrid[:ROWS, :COLS])

    def frame(height_mm: float) -> SeatedFrame:
        views = true.project(rest - [0.0, 0.0, height_mm])
        left_px, right_px = (view + rng.normal(0.0, 0.03, view.shape) for view in views)
        return SeatedFrame(height_mm, rows, cols, left_px, right_px)

    frames = [frame(height_mm) for height_mm in (0.0, 0.0, 0.8, 1.8)]
    design = {**layers, "gap_mm": 20.4, "gel_index": 1.44}
    found = calibrate_layers(true, frames, pitch_mm=pitch_mm, layers=design)
    assert abs(found.values["gap_mm"] - 20.0) < 4 * found.sigma["gap_mm"]
    assert abs(found.values["gel_index"] - 1.41) < 4 * found.sigma["gel_index"]
    assert abs(found.pitch_mm - 0.9) < 4 * found.pitch_sigma_mm and not found.doubts
    with pytest.raises(CalibrationError, match=r"pitch_mm is \(0.9, 1.2, 1.0\); valid is .* two"):
        calibrate_layers(true, frames, pitch_mm=(0.9, 1.2, 1.0), layers=design)


@pytest.mark.parametrize(
    "effects", [{"shoulder": {}, "spread": {}}, {"elastic_layer": {}}], ids=["membranes", "layer"]
)
def test_a_simulated_press_on_a_rectangular_print_is_sensed(effects: dict[str, dict[str, float]]) -> None:
    part = {"kind": "sphere", "radius_mm": RADIUS_MM}
    of_gel = {f"effects.{name}": setting for name, setting in effects.items()}
    simulator = sensor((0.9, 1.3)).replace({"indenter": part, **of_gel})
    assert gs.Scene.from_toml(simulator.scene.to_toml()).to_dict() == simulator.scene.to_dict()
    pipeline = gs.Pipeline(simulator.scene.rig, gs.Params().replace({"lattice.pitch_mm": [0.9, 1.3]}))
    rest = simulator.press()
    pipeline.process(rest.left, rest.right)
    check = pipeline.pitch_check
    assert check is not None and not check.is_off
    assert np.abs(np.subtract(check.measured_mm, [0.9, 1.3])).max() < 5 * max(check.sigma_mm)
    pose = np.eye(4)
    pose[:2, 3] = 4.0, 0.0
    moment = simulator.press(simulator.pressed(pose, PRESS_MM))
    frame = pipeline.process(moment.left, moment.right)
    assert (frame.rows, frame.cols) == (ROWS, COLS)
    off_mm = frame.points_mm - moment.points_mm
    squares = np.einsum("ni,nij,nj->n", off_mm, np.linalg.inv(frame.covariance_mm2), off_mm)
    assert 0.4 < squares[frame.state == gs.MarkerState.SEEN].mean() / 3 < 1.6
    assert np.ptp(moment.points_mm[:, 0] - rest.points_mm[:, 0]) > 0.1


def test_the_twin_of_a_rectangular_print_is_rectangular() -> None:
    gel = {
        "rows": ROWS,
        "cols": COLS,
        "pitch_mm": [0.9, 1.6],
        "dot_radius_mm": 0.2,
        "surface_mm": SURFACE_MM,
        "centre_mm": [4.0, 0.0],
        "noise_levels": 1.5,
    }
    scene = Sensor(gs.Scene().rig, gs.Params(), gel).scene()
    assert scene.to_dict()["gel"]["pitch_mm"] == [0.9, 1.6]
