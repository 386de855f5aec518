"""`Localizer`: a part that is followed, lost and found again (simulated points, noise 0.02 mm)."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2
from test_localize_surface import corner

from gelstereo import Localizer, Params, PoseError, RegisterError, Symmetry, Template, localize
from gelstereo.geometry import se3_exp, se3_log


@pytest.fixture(scope="module")
def box() -> Template:
    return Template.from_mesh(trimesh.creation.box((8.0, 6.0, 30.0)), units="mm")


def off_deg(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.rad2deg(np.linalg.norm(se3_log(np.linalg.inv(found) @ truth)[:3])))


@pytest.mark.parametrize("method", ["surface_close", "surface_search"])
def test_a_part_is_found_followed_lost_and_found_again(box: Template, method: str) -> None:
    truth, salient, everything = corner(0.02)
    params = Params().replace({"register.method": method})
    guess = truth @ se3_exp([0.1, -0.1, 0.1, 0.5, -0.5, 0.4])
    localizer = Localizer(box, guess=guess, params=params)
    assert localizer.template is box and localizer.t_sensor_object is None
    found = localizer.process(salient, all_points_mm=everything)
    assert (
        found.tracking == "relocalized" and found.log_odds > 0 and off_deg(found.t_sensor_object, truth) < 2
    )
    assert np.array_equal(localizer.t_sensor_object, found.t_sensor_object)

    # A step to the side, a small turn.
    step = np.asarray(se3_exp([0.0, 0.0, 0.01, 0.1, 0.05, 0.0]))
    moved = salient @ step[:3, :3].T + step[:3, 3]
    found = localizer.process(moved)
    assert found.tracking == "tracking" and off_deg(found.t_sensor_object, step @ truth) < 2
    held = localizer.t_sensor_object

    # Nothing of the box's shape.
    heights = np.random.default_rng(1).uniform(27.0, 28.3, len(moved))
    lost = localizer.process(np.column_stack([moved[:, :2], heights]))
    assert lost.tracking == "lost" and lost.log_odds < 0
    assert np.array_equal(localizer.t_sensor_object, held)
    with pytest.raises(RegisterError, match="0 salient points"):
        localizer.process(np.empty((0, 3)))

    found = localizer.process(moved)
    assert found.tracking == "relocalized" and off_deg(found.t_sensor_object, step @ truth) < 2
    localizer.expect(guess)
    assert localizer.t_sensor_object is None


def test_one_contact_has_no_standing(box: Template) -> None:
    truth, salient, _ = corner(0.02)
    close = Params().replace({"register.method": "surface_close"})
    found = localize(salient, box, guess=truth, params=close)
    assert found.tracking is None and found.misfit is None and found.log_odds > 0
    assert localize(salient, box, guess=truth).log_odds is None


def test_a_declared_symmetry_gives_the_copy_nearest_to_the_guess(box: Template) -> None:
    truth, salient, everything = corner(0.02)
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    two = box.with_symmetries([Symmetry((0, 0, 1), (0, 0, 0), 2)])
    assert np.allclose(two.nearest_copy(truth @ half, truth), truth, atol=1e-12)
    search = Params().replace({"register.method": "surface_search"})
    for copy in (np.eye(4), half):
        found = localize(
            salient,
            two,
            guess=truth @ copy @ se3_exp([0.1, 0.0, 0.1, 0.5, 0.0, 0.0]),
            all_points_mm=everything,
            params=search,
        )
        off = se3_log(truth @ copy @ np.linalg.inv(found.t_sensor_object))
        assert off @ found.information @ off < chi2.isf(1e-4, 6 - len(found.free))
        assert off_deg(found.t_sensor_object, truth @ copy) < 10


@pytest.mark.parametrize("decay_mm", [1.0, 3.0, 0.1])
def test_the_misfit_is_told_where_the_gel_is_asked(box: Template, decay_mm: float) -> None:
    truth, salient, everything = corner(0.02)
    # The gel beside the box is at rest at once. The fit estimates the decay: it follows from 1 mm (0.32),
    # and not from 3 mm (1.75). A gel of 0.1 mm has no model.
    params = Params().replace({"contact.decay_mm": decay_mm})
    localizer = Localizer(box, guess=truth, params=params)
    for tracking in ("relocalized", "tracking"):
        found = localizer.process(salient, all_points_mm=everything)
        assert found.tracking == tracking
        if decay_mm == 0.1:
            assert found.misfit is None
        else:
            assert (found.misfit > 1) == (decay_mm == 3.0)


@pytest.mark.parametrize("how", ["rounded", "left out", "none"])
def test_salient_points_that_are_not_among_all_markers_are_told_of(box: Template, how: str) -> None:
    truth, salient, everything = corner(0.02)
    markers, count = {
        "rounded": (everything.astype(np.float32), len(salient)),
        "left out": (everything[~(everything == salient[5]).all(axis=1)], 1),
        "none": (np.empty((0, 3)), len(salient)),
    }[how]
    localizer = Localizer(box, guess=truth)
    first = 5 if count == 1 else 0
    told = (
        f"^{count} of {len(salient)} salient points are not among the {len(markers)} markers.* point {first};"
    )
    with pytest.raises(RegisterError, match=told):
        localizer.process(salient, all_points_mm=markers)
    with pytest.raises(RegisterError, match="give all markers of the same frame"):
        localize(salient, box, guess=truth, all_points_mm=markers)
    assert localizer.process(salient[::-1], all_points_mm=everything).tracking == "relocalized"


def test_a_guess_that_is_not_finite_is_told_where(box: Template) -> None:
    truth, salient, _ = corner(0.02)
    for entries in ([(0, 0)], [(1, 3), (2, 2)], [(3, 1)], [(i, k) for i in range(4) for k in range(4)]):
        guess = np.array(truth)
        for entry in entries:
            guess[entry] = np.nan
        row, column = min(entries)
        told = f"guess: {len(entries)} of 16 entries are NaN.* row {row}, column {column}: NaN"
        with pytest.raises(PoseError, match=told):
            localize(salient, box, guess=guess)
        with pytest.raises(PoseError, match=told):
            Localizer(box, guess=guess)
