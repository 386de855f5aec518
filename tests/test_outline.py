"""`detect.roi.left_outline_px`: a gel that is not rectangular, before a background with spots."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import gelstereo as gs

ROWS = COLS = 17
#: Markers that an octagonal gel lacks in each corner of the lattice.
CUT = 4
MISSING = [
    [row, col]
    for row in range(ROWS)
    for col in range(COLS)
    if min(row, ROWS - 1 - row) + min(col, COLS - 1 - col) < CUT
]


def scene(**changes: object) -> gs.Scene:
    gel = {"rows": ROWS, "cols": COLS, "pitch_mm": 1.0, "missing": MISSING}
    keyframes = [
        {"time_s": 0.0, "position_mm": [4.0, 0.0, 36.0]},
        {"time_s": 0.3, "position_mm": [4.5, 0.5, 33.5]},
    ]
    return gs.Scene().replace(
        {
            "gel": gel,
            "indenter": {"kind": "sphere", "radius_mm": 6.0},
            "trajectory": keyframes,
            "effects.sensor_noise.sigma_levels": 1.5,
            **changes,
        }
    )


def outlines(rig: gs.Rig, margin_mm: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the octagon around the markers, in both views."""
    half, cut = 8.0 + margin_mm, 8.0 - CUT + 0.4 * margin_mm
    turns = [(half, cut), (cut, half), (-cut, half), (-half, cut), (-half, -cut), (-cut, -half), (cut, -half)]
    corners = np.array([*turns, (half, -cut)])
    return rig.project(np.column_stack([corners + [4.0, 0.0], np.full(8, 28.7)]))


def clutter(image: np.ndarray, outline_px: np.ndarray, seed: int) -> np.ndarray:
    """Dark spots of the markers' size, everywhere outside of a polygon."""
    rng = np.random.default_rng(seed)
    spots = image.copy()
    for at in rng.uniform([0, 0], image.shape[::-1], (500, 2)):
        away = -cv2.pointPolygonTest(outline_px.astype(np.float32), tuple(map(float, at)), True)
        if away > 6.0:
            cv2.circle(spots, tuple(int(16 * x) for x in at), 16 * 5, 55, -1, cv2.LINE_AA, 4)
    return spots


@pytest.fixture(scope="module")
def shown() -> list[tuple[np.ndarray, np.ndarray]]:
    simulator = gs.Simulator(scene())
    polygons = outlines(gs.Scene().rig)
    frames = [simulator[k] for k in range(len(simulator))]
    return [(clutter(f.left, polygons[0], 1), clutter(f.right, polygons[1], 2)) for f in frames]


def params(preset: str, **changes: object) -> gs.Params:
    left_px, right_px = outlines(gs.Scene().rig)
    settings = {
        "lattice.pitch_mm": 1.0,
        "detect.roi.left_outline_px": left_px.tolist(),
        "detect.roi.right_outline_px": right_px.tolist(),
    }
    return gs.Params.preset(preset).replace({**settings, **changes})


def test_without_an_outline_spots_are_detected_and_no_row_of_them_is_labelled(
    shown: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    plain = gs.Params.preset("balanced").replace({"lattice.pitch_mm": 1.0})
    assert len(gs.Detector(plain).detect(shown[0][0])) > ROWS * COLS
    # The spots of the two views differ, so that both show only the print in the same places.
    pipeline = gs.Pipeline(gs.Scene().rig, plain)
    frame = pipeline.process(*shown[0])
    truth_mm = np.asarray(gs.Simulator(scene())[0].points_mm)
    apart_mm = np.linalg.norm(frame.points_mm[:, None] - truth_mm, axis=-1).min(axis=1)
    assert apart_mm[frame.state == gs.MarkerState.SEEN].max() < 0.05
    assert (frame.rows, frame.cols) != (ROWS, COLS) and sum(pipeline.left_out) > 0


@pytest.mark.parametrize("preset", ["fast", "balanced", "exact"])
def test_an_octagonal_gel_before_spots_is_followed(
    shown: list[tuple[np.ndarray, np.ndarray]], preset: str
) -> None:
    clean = gs.Simulator(scene())
    bare = gs.Params.preset(preset).replace({"lattice.pitch_mm": 1.0})
    pipeline, alone = gs.Pipeline(gs.Scene().rig, params(preset)), gs.Pipeline(gs.Scene().rig, bare)
    printed = np.ones(ROWS * COLS, bool)
    printed[[row * COLS + col for row, col in MISSING]] = False
    for k, pair in enumerate(shown):
        frame = pipeline.process(*pair)
        same = alone.process(clean[k].left, clean[k].right)
        seen = frame.state == gs.MarkerState.SEEN
        assert (frame.rows, frame.cols) == (ROWS, COLS)
        assert not seen[~printed].any() and seen[printed].mean() > 0.97
        both = seen & (same.state == gs.MarkerState.SEEN)
        assert np.abs(frame.points_mm - same.points_mm)[both].max() < 0.05
        if preset == "fast" and k > 1:
            assert frame.left.searched == frame.right.searched == "windows"
    assert frame.salient.sum() > 20


def test_inspect_looks_within_an_outline(shown: list[tuple[np.ndarray, np.ndarray]]) -> None:
    left_px, _ = outlines(gs.Scene().rig)
    assert len(gs.inspect(shown[0][0]).dots_px) > ROWS * COLS
    found = gs.inspect(shown[0][0], outline_px=left_px)
    assert found.layout.kind == "square" and len(found.dots_px) == ROWS * COLS - len(MISSING)
    assert "detect.roi.left_outline_px" not in found.settings


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ([[0.0, 0.0], [1.0, 1.0]], "left_outline_px is 2; valid is 3 to 1000 corners"),
        ([[0.0, 0.0], [1.0, 1.0], [1e6, 0.0]], "valid is corners within"),
    ],
)
def test_a_polygon_that_is_none_is_refused(corners: list[list[float]], message: str) -> None:
    with pytest.raises(gs.ParamsError, match=message):
        gs.Params().replace({"detect.roi.left_outline_px": corners})
