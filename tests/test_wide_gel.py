"""Gels of which the cameras see a part: both views agree on rows, columns and every marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from drawn import SURFACE_MM, Press, Sensor

import gelstereo as gs

Array = npt.NDArray[np.float64]

PITCH_MM = 0.85
BALL = Press("ball", 1.0, (0.4, -0.3), radius_mm=6.0)


@dataclass(frozen=True)
class WideSensor(Sensor):
    """A gel that reaches beyond both views, with the middle of the view at a place of the print."""

    tray: bool = False
    hexagonal: bool = False
    side: int = 60
    turn_rad: float = 0.06
    middle_pitches: tuple[float, float] = (0.3, 0.2)

    @property
    def rest_mm(self) -> Array:
        row, col = (grid.ravel() - self.side // 2 for grid in np.mgrid[0 : self.side, 0 : self.side])
        x, y = (np.stack([col, row]) + np.array(self.middle_pitches)[:, None]) * PITCH_MM
        if self.hexagonal:
            x, y = x + 0.5 * PITCH_MM * (row % 2), y * np.sqrt(0.75)
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        x, y = cos * x - sin * y, sin * x + cos * y
        return np.column_stack([x + 3.0, y, np.full(len(x), SURFACE_MM)])


def params(hexagonal: bool = False, **settings: object) -> gs.Params:
    layout = {"lattice.layout": "hexagonal" if hexagonal else "square"}
    return gs.Params.preset("balanced").replace({"lattice.pitch_mm": PITCH_MM, **layout, **settings})


def names(frame: gs.Frame, truth_mm: Array) -> Array:
    """The printed marker that each point is."""
    apart_mm = np.linalg.norm(frame.points_mm[:, None] - truth_mm[None], axis=-1)
    seen = frame.state == gs.MarkerState.SEEN
    assert apart_mm.min(axis=1)[seen].max() < 0.25
    return apart_mm.argmin(axis=1)


@pytest.mark.parametrize("hexagonal", [False, True])
@pytest.mark.parametrize(("turn", "middle"), [(0.0, (0.5, 0.5)), (0.06, (0.3, 0.2)), (-0.3, (0.1, 0.8))])
def test_row_51_a_gel_wider_than_both_views(
    hexagonal: bool, turn: float, middle: tuple[float, float]
) -> None:
    sensor = WideSensor(hexagonal=hexagonal, turn_rad=turn, middle_pitches=middle)
    pipeline = gs.Pipeline(sensor.rig, params(hexagonal))
    rest = pipeline.process(*sensor.pair(sensor.rest_mm, 1))
    who = names(rest, sensor.rest_mm)
    assert len(set(who)) == len(who) > 250
    row, col = np.divmod(who, sensor.side)
    # Rows and columns are those of the print.
    assert (np.diff(row.reshape(rest.rows, rest.cols), axis=1) == 0).all()
    assert (np.diff(row.reshape(rest.rows, rest.cols), axis=0) == 1).all()
    assert (np.diff(col.reshape(rest.rows, rest.cols), axis=1) == 1).all()
    for step in range(1, 6):
        press = Press("ball", BALL.depth_mm * step / 5, BALL.place_mm, radius_mm=BALL.radius_mm)
        truth_mm = sensor.markers_mm(press)
        frame = pipeline.process(*sensor.pair(truth_mm, 10 + step))
        seen = frame.state == gs.MarkerState.SEEN
        # Corners of the rectangle may be out of view: up to a fifth, `lattice.max_missing_share`.
        assert (seen == (rest.state == gs.MarkerState.SEEN)).mean() > 0.98
        assert np.linalg.norm(frame.points_mm - truth_mm[who], axis=1)[seen].max() < 0.25
    for step in range(1, 6):
        # The whole gel slides by a fifth of a pitch from frame to frame, beyond one pitch.
        moved_mm = sensor.markers_mm(BALL, (0.2 * PITCH_MM * step, -0.1 * PITCH_MM * step))
        slid = pipeline.process(*sensor.pair(moved_mm, 20 + step))
        seen = slid.state == gs.MarkerState.SEEN
        assert seen.mean() > 0.8
        assert np.linalg.norm(slid.points_mm - moved_mm[who], axis=1)[seen].max() < 0.25
    away_mm = np.hypot(*(sensor.rest_mm[who, :2] - [3.0 + BALL.place_mm[0], BALL.place_mm[1]]).T)
    rim_mm = np.sqrt(BALL.radius_mm * BALL.depth_mm)
    assert frame.salient[away_mm < rim_mm - 0.3].mean() > 0.9
    assert not frame.salient[away_mm > rim_mm + 2 * PITCH_MM].any()


@pytest.mark.parametrize("hexagonal", [False, True])
def test_row_51_covered_markers_of_a_wide_gel_are_held(hexagonal: bool) -> None:
    sensor = WideSensor(hexagonal=hexagonal)
    pipeline = gs.Pipeline(sensor.rig, params(hexagonal))
    rest = pipeline.process(*sensor.pair(sensor.rest_mm, 1))
    who = names(rest, sensor.rest_mm)
    middle = np.hypot(*(sensor.rest_mm[:, :2] - [3.0, 0.0]).T)
    shown = middle > 2.0
    frame = pipeline.process(*sensor.pair(sensor.rest_mm[shown] + [0.1, 0.05, 0.0], 2))
    seen = frame.state == gs.MarkerState.SEEN
    assert (seen == (shown[who] & (rest.state == gs.MarkerState.SEEN))).mean() > 0.98
    truth_mm = sensor.rest_mm[who] + [0.1, 0.05, 0.0]
    assert np.linalg.norm(frame.points_mm - truth_mm, axis=1)[seen].max() < 0.25


def test_row_51_what_is_left_out_is_told() -> None:
    # Columns beside the view of the left camera only, and rows that both show in part.
    sensor = WideSensor(turn_rad=0.15)
    pipeline = gs.Pipeline(sensor.rig, params())
    assert pipeline.left_out == (0, 0, 0, 0)
    pipeline.process(*sensor.pair(sensor.rest_mm, 1))
    assert sum(pipeline.left_out) > 0
    pipeline.reset()
    assert pipeline.left_out == (0, 0, 0, 0)


def test_row_51_a_wrong_pitch_is_refused_where_no_border_is_whole() -> None:
    """A column off changes the pitch by a seventh: half of that is nearest to no column."""
    sensor = WideSensor()
    wrong = params(**{"lattice.pitch_mm": PITCH_MM * 1.07})
    with pytest.raises(gs.LabelError, match="neither view shows a whole border"):
        gs.Pipeline(sensor.rig, wrong).process(*sensor.pair(sensor.rest_mm, 1))


def test_row_51_a_covered_border_column_is_left_out() -> None:
    sensor = Sensor(tray=False)
    rest_mm = sensor.rest_mm
    row, col = np.divmod(np.arange(len(rest_mm)), 25)
    covered = (col == 24) & (row > 8)
    pipeline = gs.Pipeline(sensor.rig, params())
    frame = pipeline.process(*sensor.pair(rest_mm[~covered], 1))
    who = names(frame, rest_mm)
    assert (frame.rows, frame.cols) == (25, 24) and pipeline.left_out == (0, 1, 0, 0)
    assert (np.divmod(who, 25)[1] == np.tile(np.arange(24), 25)).all()
