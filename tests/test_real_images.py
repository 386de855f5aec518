"""Detection and labels on real gel images of other people."""

from __future__ import annotations

import gelstereo
import numpy as np
import pytest
from gelstereo.reports.gels import GELS, RealGel, draw
from real_data import DATA, needs

TACT = [gel for gel in GELS if gel.name.startswith("9dtact")]
KHSU = next(gel for gel in GELS if gel.name == "khsu")

by_name = pytest.mark.parametrize("gel", TACT, ids=lambda gel: gel.name)


def smooth_map_error_px(gel: RealGel, lattice: gelstereo.RestLattice) -> np.ndarray:
    """Distance of every detected marker from a polynomial map (row, column) -> pixel of degree 3.

    The map is fitted robustly to all markers; one wrong label is off by a pitch, and a shifted row or column by a
    pitch at its ends.
    """
    row, col = np.divmod(np.arange(gel.rows * gel.cols), gel.cols)
    row, col = row / gel.rows - 0.5, col / gel.cols - 0.5
    basis = np.column_stack([row**i * col**j for i in range(4) for j in range(4 - i)])
    seen = ~lattice.filled
    weights = np.ones(int(seen.sum()))
    for _ in range(10):
        root = np.sqrt(weights)[:, None]
        map_px = np.linalg.lstsq(root * basis[seen], root * lattice.positions_px[seen], rcond=None)[0]
        error = np.linalg.norm(basis[seen] @ map_px - lattice.positions_px[seen], axis=1)
        weights = 1.0 / (1.0 + (error / 3.0) ** 2)
    return error


@needs("9dtact_calib")
@by_name
def test_all_faint_markers_are_found_and_labelled(gel: RealGel) -> None:
    lattice = gel.locate(DATA)
    assert not lattice.filled.any()
    # The markers are pressed by hand-made pins: up to a tenth of the pitch off a smooth map, never half of it.
    assert smooth_map_error_px(gel, lattice).max() < lattice.pitch_px / 4.0


@needs("9dtact_calib")
@needs("khsu_markers")
@pytest.mark.parametrize(("name", "whole"), [("9dtact-1", 63), ("9dtact-2", 63), ("khsu", 77)])
def test_one_setting_finds_the_markers_of_every_gel(name: str, whole: int) -> None:
    """Neither threshold nor sizes are tuned to the gel: 15 levels of contrast and 65 px of pitch, or 35 and 50."""
    gel = next(gel for gel in GELS if gel.name == name)
    polarity = "bright" if name == "khsu" else "dark"
    detect = {"background": "blocks", "threshold": "auto", "centre": "grey", "polarity": polarity}
    found = gelstereo.Detector(gelstereo.Params().replace(detect=detect)).detect(gel.read(DATA))
    assert len(found) == whole
    # Those found with settings of their own, except one or two beside the border.
    tuned = gelstereo.Detector(gel.params()).detect(gel.read(DATA)).centres_px
    apart = np.linalg.norm(found.centres_px[:, None] - tuned[None], axis=2).min(axis=1)
    assert np.median(apart) < 1.0
    assert (apart < 4.0).sum() >= whole - 2


@needs("9dtact_calib")
@by_name
def test_scale_and_centre_agree_with_the_authors(gel: RealGel) -> None:
    row, col, mm_per_px = np.load(DATA / "9dtact_calib" / f"s{gel.name[-1]}_position_scale.npy")
    grid = gel.locate(DATA).positions_px.reshape(gel.rows, gel.cols, 2)
    # The authors' centre is the middle marker, rounded to whole pixels by their own detection.
    np.testing.assert_allclose(grid[gel.rows // 2, gel.cols // 2], (col, row), atol=1.5)
    around = grid[2:5, 3:6]
    pitch_px = np.mean([np.linalg.norm(np.diff(around, axis=axis), axis=-1).mean() for axis in (0, 1)])
    # 2.5 mm pitch; the pins stand 3 px rms off the smooth map, so a mean of twelve pitches is good to 2 %.
    assert 2.5 / pitch_px == pytest.approx(mm_per_px, rel=0.02)


@needs("9dtact_calib")
@by_name
def test_algorithm_1_gives_the_same_labels(gel: RealGel) -> None:
    params = gel.params()
    detected_px = gelstereo.Detector(params).detect(gel.read(DATA)).centres_px
    lattice = gelstereo.rest_lattice(detected_px, params)
    order = gelstereo.foresight_sort(detected_px, gel.rows, gel.cols, lattice.pitch_px / 3.0)
    np.testing.assert_array_equal(detected_px[order], lattice.positions_px)


@needs("khsu_markers")
def test_bent_rows_are_labelled_and_cut_off_markers_filled_in() -> None:
    lattice = KHSU.locate(DATA)
    assert int(lattice.filled.sum()) == KHSU.max_missing
    row, col = np.divmod(np.flatnonzero(lattice.filled), KHSU.cols)
    # Only markers that the border cuts: the upper row, and the ends of the second and third.
    assert set(row) <= {0, 1, 2}
    assert all(c in (0, KHSU.cols - 1) for r, c in zip(row, col, strict=True) if r > 0)
    assert smooth_map_error_px(KHSU, lattice).max() < lattice.pitch_px / 8.0


@needs("khsu_markers")
def test_every_label_sits_on_yellow_paint() -> None:
    import cv2

    lattice = KHSU.locate(DATA)
    image = cv2.imread(str(DATA / KHSU.path)).astype(float)
    yellowness = cv2.blur(np.minimum(image[:, :, 1], image[:, :, 2]) - image[:, :, 0], (5, 5))
    x, y = np.round(lattice.positions_px[~lattice.filled]).astype(int).T
    between = (lattice.positions_px.reshape(KHSU.rows, KHSU.cols, 2)[1:-1, 1:-1]).reshape(-1, 2)
    half_way_down = np.array([0.0, 0.4 * lattice.pitch_px])
    between = np.round(between + half_way_down).astype(int)
    gap = np.median(yellowness[between[:, 1], between[:, 0]])
    assert yellowness[y, x].min() > gap + 20.0


@needs("khsu_markers")
@needs("9dtact_calib")
@pytest.mark.parametrize("preset", gelstereo.Params.presets())
@pytest.mark.parametrize("gel", GELS, ids=lambda gel: gel.name)
def test_presets_made_for_another_print_say_what_they_found(gel: RealGel, preset: str) -> None:
    # A limit of today: the threshold of 35 levels is fixed, and these prints have less contrast.
    with pytest.raises(gelstereo.Error, match=r"found \d+ markers|none of the \d+ markers"):
        gel.locate(DATA, preset)


@needs("khsu_markers")
def test_drawing_marks_every_position() -> None:
    lattice = KHSU.locate(DATA)
    grey = np.full((480, 640, 3), 128, np.uint8)
    drawn = draw(grey, lattice, KHSU.cols)
    assert drawn.shape == (960, 1280, 3)
    positions = (lattice.positions_px + 0.5) * 2 - 0.5
    inside = (positions >= 10).all(axis=1) & (positions < [1270, 950]).all(axis=1)
    for x, y in np.round(positions[inside]).astype(int):
        assert (drawn[y - 9 : y + 10, x - 9 : x + 10] != 128).any()
