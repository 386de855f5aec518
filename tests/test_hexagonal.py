"""Hexagonal prints from images to points, contact and pose; drawn without the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from drawn import SHOULDER_MM, SURFACE_MM, Press, Sensor

import gelstereo as gs
from gelstereo.calibrate.board_names import BoardKind
from gelstereo.setup import Plan, compare_sensors, gel
from gelstereo.setup.plan import Views
from gelstereo.setup.prints import look
from gelstereo.setup.sensor import Sensor as Sensors

Array = npt.NDArray[np.float64]

ROWS, COLS, PITCH_MM = 20, 21, 0.85
BALL = Press("ball", 1.0, (0.4, -0.3), radius_mm=6.0)
#: Where the drawn gel leaves the ball.
RIM_MM = float(np.sqrt(BALL.radius_mm * BALL.depth_mm))
#: Error of the contact's border: a pitch, and the part of the shoulder that is nearly as high as the contact.
ASIDE_MM = PITCH_MM + SHOULDER_MM / 4


@dataclass(frozen=True)
class HexagonalSensor(Sensor):
    """A sensor whose every second row is shifted by half a pitch."""

    turn_rad: float = 0.05

    @property
    def rest_mm(self) -> Array:
        row, col = (grid.ravel().astype(np.float64) for grid in np.mgrid[0:ROWS, 0:COLS])
        x = (col + 0.5 * (row % 2) - COLS / 2 + 0.25) * PITCH_MM
        y = (row - (ROWS - 1) / 2) * np.sqrt(0.75) * PITCH_MM
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        x, y = cos * x - sin * y, sin * x + cos * y
        return np.column_stack([x + 3.0, y, np.full(len(x), SURFACE_MM)])


def params(preset: str = "balanced", **settings: object) -> gs.Params:
    print_settings = {"lattice.layout": "hexagonal", "lattice.pitch_mm": PITCH_MM}
    return gs.Params.preset(preset).replace({**print_settings, **settings})


def press(sensor: Sensor, pipeline: gs.Pipeline, seed: int = 0, steps: int = 5) -> list[gs.Frame]:
    """Frames from rest to the whole press."""
    frames = []
    for k in range(steps + 1):
        share = Press("ball", BALL.depth_mm * k / steps, BALL.place_mm, radius_mm=BALL.radius_mm)
        points_mm = sensor.markers_mm(share if k else None)
        frames.append(pipeline.process(*sensor.pair(points_mm, 10 * seed + k)))
    return frames


@pytest.mark.parametrize("preset", ["fast", "balanced", "exact"])
def test_a_ball_on_a_hexagonal_print(preset: str) -> None:
    sensor = HexagonalSensor()
    pipeline = gs.Pipeline(sensor.rig, params(preset))
    frames = press(sensor, pipeline)
    truth_mm = sensor.markers_mm(BALL)
    for frame in frames:
        assert (frame.rows, frame.cols) == (ROWS, COLS)
        assert (frame.state == gs.MarkerState.SEEN).mean() > 0.98
    assert not frames[0].salient.any()
    last = frames[-1]
    off_mm = last.points_mm - truth_mm
    seen = last.state == gs.MarkerState.SEEN
    # Of another marker it would be 0.85 mm.
    assert np.linalg.norm(off_mm[seen], axis=1).max() < 0.25
    assert np.sqrt(np.mean(off_mm[seen, 2] ** 2)) < 0.03
    away_mm = np.hypot(*(sensor.rest_mm[:, :2] - [3.0 + BALL.place_mm[0], BALL.place_mm[1]]).T)
    touches = away_mm < RIM_MM
    hits = (last.salient & touches).sum()
    f1 = 2 * hits / (last.salient.sum() + touches.sum())
    assert f1 > 0.85
    assert not last.salient[away_mm > RIM_MM + 2 * ASIDE_MM].any()


def test_the_pose_of_a_ball_on_a_hexagonal_print() -> None:
    sensor = HexagonalSensor()
    frame = press(sensor, gs.Pipeline(sensor.rig, params()))[-1]
    centre_mm = np.array(
        [3.0 + BALL.place_mm[0], BALL.place_mm[1], SURFACE_MM - BALL.depth_mm + BALL.radius_mm]
    )
    ball = gs.Template.from_mesh(trimesh.creation.icosphere(5, BALL.radius_mm), units="mm", spacing_mm=0.5)
    guess = np.eye(4)
    guess[:3, 3] = centre_mm + [0.4, -0.5, 0.2]
    found = gs.localize(frame, ball, guess=guess, params=gs.Params.preset("balanced"))
    assert found.converged
    assert np.linalg.norm(np.asarray(found.t_sensor_object)[:3, 3] - centre_mm) < 0.1


def test_a_record_of_a_hexagonal_print_is_resumed() -> None:
    sensor = HexagonalSensor()
    pipeline = gs.Pipeline(sensor.rig, params())
    press(sensor, pipeline, steps=1)
    record = pipeline.rest_record()
    assert record is not None
    again = gs.Pipeline(sensor.rig, params())
    again.resume(record)
    moved_mm = sensor.markers_mm(Press("ball", 0.3, BALL.place_mm, radius_mm=6.0), (0.2, 0.1))
    frame = again.process(*sensor.pair(moved_mm, 7))
    seen = frame.state == gs.MarkerState.SEEN
    assert seen.mean() > 0.98
    assert np.linalg.norm(frame.points_mm - moved_mm, axis=1)[seen].max() < 0.25


def test_a_covered_marker_is_held_and_found_again() -> None:
    sensor = HexagonalSensor()
    pipeline = gs.Pipeline(sensor.rig, params())
    rest_mm = sensor.markers_mm(None)
    hidden = [6 * COLS + 9, 6 * COLS + 10, 7 * COLS + 9]
    kept = np.delete(np.arange(len(rest_mm)), hidden)
    pipeline.process(*sensor.pair(rest_mm, 0))
    for seed in range(1, 4):
        frame = pipeline.process(*sensor.pair(rest_mm[kept] + [0.1 * seed, 0.0, 0.0], seed))
        assert (frame.state[hidden] == gs.MarkerState.HELD).all()
        assert (frame.state[kept] == gs.MarkerState.SEEN).mean() > 0.98
        assert (
            np.linalg.norm(
                frame.left_px[hidden] - sensor.rig.project(rest_mm + [0.1 * seed, 0, 0])[0][hidden], axis=1
            ).max()
            < 1.0
        )
    frame = pipeline.process(*sensor.pair(rest_mm + [0.4, 0.0, 0.0], 9))
    assert (frame.state == gs.MarkerState.SEEN).mean() > 0.98


def test_setup_of_a_hexagonal_print(tmp_path: Path) -> None:
    """The print, its lengths, and its digital twin."""
    sensor = HexagonalSensor()

    def views(kind: str, points: list[Array]) -> Views:
        files: tuple[list[Path], list[Path]] = ([], [])
        for seed, points_mm in enumerate(points):
            for view, image in zip(files, sensor.pair(points_mm, seed), strict=True):
                view.append(tmp_path / f"{kind}_{seed}_{'left' if view is files[0] else 'right'}.png")
                cv2.imwrite(str(view[-1]), image)
        return Views(tuple(files[0]), tuple(files[1]))

    rest = views("rest", [sensor.rest_mm] * 10)
    shares = [Press("ball", BALL.depth_mm * k / 5, BALL.place_mm, radius_mm=6.0) for k in range(1, 6)]
    pressed = views("press", [sensor.rest_mm, *(sensor.markers_mm(share) for share in shares)])
    board = BoardKind.parse("9x6").board({"square_mm": 2.0})
    # The cameras are known, so that their images are not read.
    plan = Plan(rest, board, rest, (PITCH_MM, PITCH_MM), presses=pressed, ball_radius_mm=6.0)
    step = look(plan)
    settings = step.values["settings"]
    assert settings["lattice.layout"] == "hexagonal" and settings["lattice.cols"] == COLS
    found = gel.rest(plan, sensor.rig, settings)
    assert found.values["gel"]["rows"] == ROWS and found.is_good, str(found)
    lengths = gel.presses(plan, sensor.rig, settings).values["gel"]
    # Markers of the drawn gel are on the ball, and beside it the gel returns to rest exponentially.
    assert abs(lengths["depth_mm"]) < 2 * lengths["depth_sigma_mm"]
    assert lengths["shoulder_mm"] == pytest.approx(SHOULDER_MM, rel=0.25)
    assert any(figure.usual.startswith("simulated") for figure in found.figures)
    twin = Sensors(sensor.rig, params(), found.values["gel"])
    assert compare_sensors(twin, twin).is_interchangeable
    at_rest = gs.Simulator(twin.scene()).press()
    turned = sensor.rest_mm - sensor.rest_mm.mean(axis=0)
    # The drawn print is turned in its plane by 0.05 rad.
    off_mm = at_rest.points_mm - at_rest.points_mm.mean(axis=0) - turned
    assert np.abs(off_mm).max() < 0.06 * np.abs(turned).max()


@pytest.mark.parametrize("forward", [True, False])
def test_a_simulated_print_keeps_its_names(forward: bool) -> None:
    """Markers under a ball that drags the gel are those of the scene, row by row and column by column."""
    scene = gs.Scene().replace(
        {
            "gel": {"layout": "hexagonal", "rows": 22, "cols": 19, "odd_rows_forward": forward},
            "effects": {"defocus": {}, "sensor_noise": {}, "elastic_layer": {}},
            "indenter": {"kind": "sphere", "radius_mm": 5.0},
        }
    )
    simulator = gs.Simulator(scene)
    forces = {"force.method": "bounded", "force.thickness_mm": 5.0, "force.young_kpa": 100.0}
    pipeline = gs.Pipeline(scene.rig, params(**{"lattice.pitch_mm": 0.9, **forces}))
    at_rest = simulator.press()
    pipeline.process(at_rest.left, at_rest.right)
    above = np.eye(4)
    above[:3, 3] = [4.5, 0.3, 33.0]
    for press_mm in (0.5, 1.0):
        truth = simulator.press(simulator.pressed(above, press_mm), shear_mm=(0.3, 0.2))
        found = pipeline.process(truth.left, truth.right)
        assert (found.rows, found.cols) == (22, 19)
        assert np.linalg.norm(found.left_px - truth.left_px, axis=1).max() < 0.3
        assert np.abs(found.points_mm - truth.points_mm).max() < 0.06
        hits = (found.salient & truth.in_contact).sum()
        assert 2 * hits > 0.85 * (found.salient.sum() + truth.in_contact.sum())
        assert found.wrench is not None and truth.loads is not None
        off_n = found.wrench.force_n - truth.loads.force_n
        assert np.linalg.norm(off_n) < 0.03 * np.linalg.norm(truth.loads.force_n)


def test_layouts_are_not_mistaken() -> None:
    hexagonal, square = HexagonalSensor(), Sensor()
    images = hexagonal.pair(hexagonal.rest_mm, 1)
    with pytest.raises(gs.LabelError, match=r'set lattice\.layout = "hexagonal"'):
        gs.Pipeline(hexagonal.rig, gs.Params.preset("balanced")).process(*images)
    with pytest.raises(gs.LabelError, match="the print is square"):
        gs.Pipeline(square.rig, params()).process(*square.pair(square.rest_mm, 1))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lattice.pitch_mm": [0.8, 0.9]}, "one lattice.pitch_mm"),
        ({"label.method": "foresight"}, "label.method"),
    ],
)
def test_what_a_hexagonal_print_excludes_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(gs.ParamsError, match=message):
        params(**settings)
