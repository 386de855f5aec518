"""Detection and labels on real gel images of other people."""

from __future__ import annotations

import numpy as np
import pytest
from real_data import DATA, needs

import gelstereo
from gelstereo_bench.reports.gels import GELS, RealGel, draw

TACT = [gel for gel in GELS if gel.name.startswith("9dtact")]
KHSU = next(gel for gel in GELS if gel.name == "khsu")

#: All but the paper's, whose threshold is made for its own print.
PRESETS = [preset for preset in gelstereo.Params.presets() if preset != "paper"]

by_preset = pytest.mark.parametrize("preset", PRESETS)
by_name = pytest.mark.parametrize("gel", TACT, ids=lambda gel: gel.name)


def smooth_map_error_px(lattice: gelstereo.RestLattice, used: np.ndarray) -> np.ndarray:
    """Distance of every marker from a polynomial map (row, column) -> pixel of degree 3, fitted to those
    used.

    The map is fitted robustly; one wrong label is off by a pitch, and a shifted row or column by a pitch at
    its ends.
    """
    row, col = np.divmod(np.arange(lattice.rows * lattice.cols), lattice.cols)
    row, col = row / lattice.rows - 0.5, col / lattice.cols - 0.5
    basis = np.column_stack([row**i * col**j for i in range(4) for j in range(4 - i)])
    weights = np.ones(int(used.sum()))
    for _ in range(10):
        root = np.sqrt(weights)[:, None]
        map_px = np.linalg.lstsq(root * basis[used], root * lattice.positions_px[used], rcond=None)[0]
        error = np.linalg.norm(basis @ map_px - lattice.positions_px, axis=1)
        weights = 1.0 / (1.0 + (error[used] / 3.0) ** 2)
    return np.asarray(error)


def yellowness(path: str) -> np.ndarray:
    """How yellow every pixel is: paint is, the gel between is not."""
    import cv2

    image = cv2.imread(path).astype(float)
    return np.asarray(cv2.blur(np.minimum(image[:, :, 1], image[:, :, 2]) - image[:, :, 0], (5, 5)))


def test_only_polarity_and_channel_differ() -> None:
    preset = gelstereo.Params.preset("balanced").to_dict()
    for gel in GELS:
        setting = gel.params().to_dict()
        setting["detect"]["polarity"] = preset["detect"]["polarity"]
        assert setting == preset
        assert "rows" not in setting["lattice"] and "cols" not in setting["lattice"]


@by_preset
@needs("9dtact_calib")
@by_name
def test_all_faint_markers_are_found_and_labelled(gel: RealGel, preset: str) -> None:
    located = gel.locate(DATA, preset)
    lattice = located.lattice
    assert (lattice.rows, lattice.cols) == (7, 9)
    assert len(located.markers) == 63 and not lattice.filled.any() and not located.cut.any()
    # The markers are pressed by hand-made pins: up to a tenth of the pitch off a smooth map, never half of
    # it.
    assert smooth_map_error_px(lattice, ~lattice.filled).max() < lattice.pitch_px / 4.0


@needs("9dtact_calib")
@by_name
def test_scale_and_centre_agree_with_the_authors(gel: RealGel) -> None:
    row, col, mm_per_px = np.load(DATA / "9dtact_calib" / f"s{gel.name[-1]}_position_scale.npy")
    lattice = gel.locate(DATA).lattice
    grid = lattice.positions_px.reshape(lattice.rows, lattice.cols, 2)
    # The authors' centre is the middle marker, rounded to whole pixels by their own detection.
    np.testing.assert_allclose(grid[lattice.rows // 2, lattice.cols // 2], (col, row), atol=1.5)
    around = grid[2:5, 3:6]
    pitch_px = np.mean([np.linalg.norm(np.diff(around, axis=axis), axis=-1).mean() for axis in (0, 1)])
    # 2.5 mm pitch; the pins stand 3 px rms off the smooth map, so a mean of twelve pitches is good to 2 %.
    assert 2.5 / pitch_px == pytest.approx(mm_per_px, rel=0.02)


@needs("9dtact_calib")
@by_name
def test_algorithm_1_gives_the_same_labels(gel: RealGel) -> None:
    located = gel.locate(DATA)
    detected_px, lattice = located.markers.centres_px, located.lattice
    order = gelstereo.foresight_sort(detected_px, lattice.rows, lattice.cols, lattice.pitch_px / 3.0)
    np.testing.assert_array_equal(detected_px[order], lattice.positions_px)


@by_preset
@needs("khsu_markers")
def test_bent_rows_are_labelled_and_markers_out_of_sight_filled_in(preset: str) -> None:
    located = KHSU.locate(DATA, preset)
    lattice = located.lattice
    assert (lattice.rows, lattice.cols) == (8, 11)
    assert len(located.markers) == 77
    # Every one that was seen, whole or cut, has a label.
    assert int((~lattice.filled).sum()) == 77 + len(located.markers.cut_centres_px)
    # A marker is put where none is seen only if the border hides it.
    width_px, height_px = 640, 480
    inside = np.minimum(lattice.positions_px, [width_px, height_px] - lattice.positions_px).min(axis=1)
    assert inside[lattice.filled].max() < lattice.pitch_px / 8.0
    whole = ~lattice.filled & ~located.cut
    error_px = smooth_map_error_px(lattice, whole)
    assert error_px[whole].max() < lattice.pitch_px / 8.0
    # What is left of a cut marker lies further in than its centre, by less than its half length.
    assert error_px[located.cut].max() < lattice.pitch_px / 3.0


@by_preset
@needs("khsu_markers")
def test_every_label_sits_on_yellow_paint_and_all_whole_paint_has_a_label(preset: str) -> None:
    import cv2

    located = KHSU.locate(DATA, preset)
    lattice = located.lattice
    yellow = yellowness(str(DATA / KHSU.path))
    x, y = np.round(lattice.positions_px[~lattice.filled]).astype(int).T
    between = lattice.positions_px.reshape(lattice.rows, lattice.cols, 2)[1:-1, 1:-1].reshape(-1, 2)
    half_way_down = np.array([0.0, 0.4 * lattice.pitch_px])
    between = np.round(between + half_way_down).astype(int)
    gap = np.median(yellow[between[:, 1], between[:, 0]])
    assert yellow[y, x].min() > gap + 20.0
    # Patches of paint by colour alone, those clear of the border. Stains are half as yellow as paint.
    patches = (yellow - cv2.GaussianBlur(yellow, (0, 0), 15.0) > 20.0).astype(np.uint8)
    _, _, boxes, centres_px = cv2.connectedComponentsWithStats(patches)
    left, top, width, height, area = boxes[1:].T
    clear = (left > 2) & (top > 2) & (left + width < 638) & (top + height < 478) & (area > 150)
    labelled_px = lattice.positions_px[~lattice.filled]
    apart_px = np.linalg.norm(centres_px[1:][clear, None] - labelled_px, axis=2).min(axis=1)
    assert clear.sum() >= 74
    assert apart_px.max() < 10.0


@needs("9dtact_calib")
@needs("khsu_markers")
@pytest.mark.parametrize("gel", GELS, ids=lambda gel: gel.name)
def test_the_papers_threshold_is_for_another_print_and_says_what_it_found(gel: RealGel) -> None:
    with pytest.raises(gelstereo.Error, match=r"none of the 0 markers found .* detect\.threshold_levels"):
        gel.locate(DATA, "paper")


@needs("khsu_markers")
def test_drawing_marks_every_position() -> None:
    located = KHSU.locate(DATA)
    grey = np.full((480, 640, 3), 128, np.uint8)
    drawn = draw(grey, located)
    assert drawn.shape == (960, 1280, 3)
    positions = (located.lattice.positions_px + 0.5) * 2 - 0.5
    inside = (positions >= 10).all(axis=1) & (positions < [1270, 950]).all(axis=1)
    for x, y in np.round(positions[inside]).astype(int):
        assert (drawn[y - 9 : y + 10, x - 9 : x + 10] != 128).any()
