"""Interpolation and the plate of `gelstereo_bench.reports.smooth` and `stiff_skin`: laws of any lattice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from gelstereo_bench.reports.free_sides import of_sides
from gelstereo_bench.reports.physics import Gel, Press
from gelstereo_bench.reports.smooth import Spline
from gelstereo_bench.reports.stiff_skin import bending, compliance, predicted, stretching
from outside import judge_plate

SHAPE = (7, 6)
ROW, COL = np.indices(SHAPE).astype(float)


@pytest.mark.parametrize("reach", [0, 1])
def test_a_spline_misses_what_a_fit_without_the_block_misses(reach: int) -> None:
    values = np.random.default_rng(0).normal(size=(*SHAPE, 3))
    chosen = np.zeros(SHAPE, bool)
    chosen[0, 2] = chosen[3, 4] = True
    places = np.column_stack([ROW.ravel(), COL.ravel()])
    expected = []
    for row, col in np.argwhere(chosen):
        far = np.abs(places - [row, col]).max(axis=1) > reach
        fit = RBFInterpolator(places[far], values.reshape(-1, 3)[far], kernel="thin_plate_spline")
        expected.append(values[row, col] - fit([[row, col]])[0])
    np.testing.assert_allclose(Spline.of(SHAPE).misses(values, chosen, reach), expected, atol=1e-9)


def motion(along: np.ndarray, down: np.ndarray, up: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(along, down, up), axis=-1).ravel()


def test_a_plate_resists_strain_and_curvature_alone() -> None:
    rigid = motion(0.3 - 0.2 * ROW, 0.1 + 0.2 * COL, 1.0 + 0.4 * ROW - 0.3 * COL)
    for stiffness in (stretching(SHAPE), bending(SHAPE)):
        np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-12)
        assert np.abs(stiffness @ rigid).max() < 1e-12
    # Pulled along and free to narrow, it has Young's modulus: its energy an area is half the strain squared.
    strain, area = 0.01, (SHAPE[0] - 1) * (SHAPE[1] - 1)
    pulled = motion(strain * COL, -0.5 * strain * ROW, 0.0)
    assert 0.5 * pulled @ stretching(SHAPE) @ pulled == pytest.approx(0.5 * strain**2 * area)
    sheared = motion(strain * ROW, 0.0, 0.0)
    assert sheared @ stretching(SHAPE) @ sheared == pytest.approx(strain**2 * area / 3.0)
    # A parabola with a curvature of 2 along the columns, at five rows within and in every column.
    bent = motion(0.0, 0.0, ROW**2)
    assert bent @ bending(SHAPE) @ bent == pytest.approx(4.0 * (SHAPE[0] - 2) * SHAPE[1])


def test_without_a_skin_the_layer_is_that_of_the_free_sides() -> None:
    gel, pitch_mm, rim_mm = Gel(5.0, 0.5), 1.0, 2.0
    touches = np.hypot(ROW - 3.0, COL - 2.5) < 1.6
    # Deepest in the middle, so that the layer presses everywhere.
    depth = np.where(touches, 0.5 - 0.1 * np.hypot(ROW - 3.0, COL - 2.5) ** 2, 0.0)
    press = Press(np.stack([0.05 * touches, 0.0 * depth, depth], axis=-1), touches, ~touches)
    layer = np.linalg.inv(compliance(gel, SHAPE, pitch_mm, rim_mm))
    np.testing.assert_allclose(predicted(layer, press), of_sides(press, gel, pitch_mm, rim_mm), atol=2e-3)


def test_a_plate_describes_the_gel_over_a_deep_print_alone() -> None:
    """On gels of one material, solved by finite elements: docs/simulator-physics.md."""
    found = judge_plate.presses("w")
    without, with_plate = judge_plate.left(found["a", 0.8], Gel(3.2, 0.48), (0.0, 0.8))
    assert with_plate < 0.9 * without
    without, with_plate = judge_plate.left(found["a", 0.0], Gel(4.0, 0.48), (0.0, 0.8))
    assert with_plate > 1.2 * without
