"""Parts that move on from their last pose, from Python."""

from __future__ import annotations

import numpy as np
import pytest

import gelstereo as gs

BALL = {"kind": "sphere", "radius_mm": 4.0}


def pose(x_mm: float, z_mm: float = 40.0) -> np.ndarray:
    found = np.eye(4)
    found[:3, 3] = x_mm, 0.0, z_mm
    return found


def test_a_drag_is_seen_in_the_images_of_its_frame() -> None:
    """Markers under the ball follow it; the images are those of the moved markers."""
    scene = gs.Scene().replace(indenter=BALL, effects={"elastic_layer": {"friction": 5.0}})
    sensor = gs.Simulator(scene)
    held = sensor.pressed(pose(4.0), 0.6)
    before = sensor.advance(held, frame=1)
    left = before.left.copy()
    held = held.copy()
    held[0, 3] += 0.2
    after = sensor.advance(held, frame=2)
    moved = (after.points_mm - before.points_mm)[before.in_contact, 0]
    assert np.all(moved > 0.1) and moved.max() < 0.25
    assert after.index == 2 and np.any(after.left != left)
    np.testing.assert_array_equal(before.left, left, "an earlier frame stays what it was")
    np.testing.assert_allclose(after.t_sensor_object, held)
    away = sensor.advance(frame=3)
    assert away.t_sensor_object is None and not away.in_contact.any()


def test_a_force_needs_a_layer_and_a_part() -> None:
    bare = gs.Simulator(gs.Scene())
    with pytest.raises(gs.SceneError, match="the scene has no indenter"):
        bare.advance(pose(4.0))
    rigid = gs.Simulator(gs.Scene().replace(indenter=BALL))
    with pytest.raises(gs.SceneError, match=r"needs effects\.elastic_layer"):
        rigid.advance(pose(4.0, 31.0))
    for sensor in (bare, rigid):
        with pytest.raises(gs.SceneError, match="needs an indenter and effects"):
            sensor.pressed_with(pose(4.0), 1.0)
    soft = gs.Simulator(gs.Scene().replace(indenter=BALL, effects={"elastic_layer": {}}))
    with pytest.raises(gs.SceneError, match="force_n is 1000; valid is less than"):
        soft.pressed_with(pose(4.0), 1000.0)
    with pytest.raises(gs.PoseError):
        soft.advance(np.full((4, 4), np.nan))
