"""The surface between markers and the pressure on it, against NumPy and SciPy."""

from __future__ import annotations

import numpy as np
import pytest

import gelstereo
from gelstereo import DenseSurface, RestSurface, pressure_saliency

ROWS, COLS, PITCH_MM, DECAY_MM = 13, 11, 0.9, 2.0


def lattice(layout: str = "square") -> np.ndarray:
    row, col = (grid.ravel().astype(float) for grid in np.mgrid[:ROWS, :COLS])
    if layout == "hexagonal":
        row, col = np.sqrt(0.75) * row, col + 0.5 * (row % 2)
    return np.stack([PITCH_MM * col, PITCH_MM * row, np.full(col.size, 28.7)], axis=1)


def beside(layout: str) -> np.ndarray:
    """Whether two markers are neighbours."""
    points = lattice(layout)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    return (apart > 0.0) & (apart < 1.01 * PITCH_MM)


def stencils(layout: str) -> np.ndarray:
    """h - l² Δh as a matrix, borders mirrored."""
    near = beside(layout).astype(float)
    share = 2.0 / 3.0 if layout == "hexagonal" else 1.0
    laplacian = share * (near - np.diag(near.sum(axis=1))) / PITCH_MM**2
    return np.eye(ROWS * COLS) - DECAY_MM**2 * laplacian


@pytest.mark.parametrize(("layout", "whole"), [("square", 4), ("hexagonal", 6)])
def test_labels_are_a_best_answer_to_kriged_pressures(layout: str, whole: int) -> None:
    """Every label agrees with NumPy's own conditional pressure: no single change would lower the energy."""
    random = np.random.default_rng(3)
    a, n, sigma, near = stencils(layout), ROWS * COLS, 0.015, beside(layout)
    r, c = np.divmod(np.arange(n), COLS)
    force = ((abs(r - 6) <= 3) & (abs(c - 5) <= 2)) * 1.5
    heights = np.linalg.solve(a, force) + sigma * random.normal(size=n)
    salient, pressure = pressure_saliency(
        RestSurface(lattice(layout)),
        heights,
        np.full(n, sigma**2),
        rows=ROWS,
        cols=COLS,
        decay_mm=DECAY_MM,
        layout=layout,
    )
    # Round-off of a few products of 30. Without prediction, noise hides some of the pressures.
    np.testing.assert_allclose(pressure, a @ heights, atol=1e-12)
    covariance = sigma**2 * a @ a.T
    # Of markers at the border the pressure is known from fewer neighbours, and predicts nothing.
    inner = near.sum(axis=1) == whole
    for i in range(n):
        used = (abs(covariance[i]) > 0.0) & inner & inner[i] & ~salient
        used[i] = False
        share = np.linalg.solve(covariance[np.ix_(used, used)], covariance[used, i])
        left = pressure[i] - share @ pressure[used]
        variance = covariance[i, i] - share @ covariance[used, i]
        choice = 4.0 * max(heights[i], 0.0) / np.sqrt(2.0 * np.pi * variance)
        edges = 4.0 * (near[i].sum() - 2 * (near[i] & salient).sum())
        score = left * abs(left) / variance - 2.0 * np.log1p(choice) - edges
        assert (score > -1e-6) == salient[i] or abs(score) < 1e-6, i
    assert np.array_equal(salient, force > 0)


def test_pressure_refuses_by_name() -> None:
    rest, n = RestSurface(lattice()), ROWS * COLS
    good = {"rows": ROWS, "cols": COLS, "decay_mm": DECAY_MM}
    with pytest.raises(gelstereo.ContactError, match="the decay length is 0 mm"):
        pressure_saliency(rest, np.zeros(n), np.ones(n), **{**good, "decay_mm": 0.0})
    with pytest.raises(gelstereo.ContactError, match="variance below 0"):
        pressure_saliency(rest, np.zeros(n), -np.ones(n), **good)
    with pytest.raises(gelstereo.ContactError, match="143"):
        pressure_saliency(rest, np.zeros(12), np.ones(n), **good)
    salient, _ = pressure_saliency(rest, np.full(n, np.nan), np.ones(n), **good)
    assert not salient.any()
    with pytest.raises(ValueError, match='the layout is "round"; valid are "square" and "hexagonal"'):
        pressure_saliency(rest, np.zeros(n), np.ones(n), **good, layout="round")
    with pytest.raises(gelstereo.ContactError, match="143"):
        pressure_saliency(rest, np.zeros(n), np.ones(n), **{**good, "rows": ROWS + 1}, layout="hexagonal")


def test_row_13_exact_lattice_agrees_with_scipys_hull() -> None:
    spatial = pytest.importorskip("scipy.spatial")
    rest = lattice()[:, :2]
    surface = DenseSurface(rest, 0.45)
    assert len(spatial.Delaunay(rest).simplices) == 2 * (ROWS - 1) * (COLS - 1)
    assert surface.mask.all()
    assert surface.shape == (2 * ROWS - 1, 2 * COLS - 1)
    # In the middle of four markers symmetry gives the weights, and on the hull there are two neighbours only.
    values = np.random.default_rng(1).normal(size=(ROWS, COLS))
    dense = surface.sample(values.ravel())
    np.testing.assert_allclose(dense[::2, ::2], values, atol=1e-12)
    for side in (0, -1):
        np.testing.assert_allclose(dense[1::2, side], (values[1:, side] + values[:-1, side]) / 2, atol=1e-12)
    four = (values[1:, 1:] + values[:-1, 1:] + values[1:, :-1] + values[:-1, :-1]) / 4
    np.testing.assert_allclose(dense[1::2, 1::2], four, atol=1e-12)


def test_weights_agree_with_inserted_voronoi_regions() -> None:
    """Sibson's weights by his definition: areas that a new marker's region takes from the
    others', by SciPy.
    """
    spatial = pytest.importorskip("scipy.spatial")
    random = np.random.default_rng(2)
    rest = lattice()[:, :2] + random.uniform(-0.2, 0.2, (ROWS * COLS, 2))
    surface = DenseSurface(rest, 0.7)
    values = random.normal(size=len(rest))
    dense, n = surface.sample(values), len(rest)

    def areas(points: np.ndarray) -> np.ndarray:
        cells = spatial.Voronoi(points)
        regions = (cells.regions[k] for k in cells.point_region)
        hulls = (
            spatial.ConvexHull(cells.vertices[region]).volume if region and min(region) >= 0 else np.nan
            for region in regions
        )
        return np.fromiter(hulls, float)

    before, compared = areas(rest), 0
    for row, col in np.ndindex(*surface.shape):
        x, y = surface.x_mm[col], surface.y_mm[row]
        if not (2.5 < x < (COLS - 1) * PITCH_MM - 2.5 and 2.5 < y < (ROWS - 1) * PITCH_MM - 2.5):
            continue
        after = areas(np.vstack([rest, [x, y]]))
        taken = np.nan_to_num(before - after[:n])
        # Areas of about 1 mm² are differences of products of coordinates of 10 mm, which round 1e2 eps.
        assert dense[row, col] == pytest.approx(taken @ values / after[n], abs=1e-10)
        compared += 1
    assert compared > 30


def test_planes_are_exact_and_nothing_is_nan() -> None:
    points = lattice()
    turned = points[:, :2] @ [[0.8, 0.6], [-0.6, 0.8]]
    surface = DenseSurface(turned, 0.3)
    cloud = np.column_stack([turned, 28.7 + turned @ [0.2, -0.1]])
    dense, normals = surface.points(cloud)
    mask = surface.mask
    assert 0.3 < mask.mean() < 0.7
    assert not dense[~mask].any() and not normals[~mask].any()
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    np.testing.assert_allclose(dense[mask], np.stack([x, y, 28.7 + 0.2 * x - 0.1 * y], -1)[mask], atol=1e-11)
    normal = np.array([0.2, -0.1, -1.0])
    np.testing.assert_allclose(
        normals[mask], np.tile(normal / np.linalg.norm(normal), (mask.sum(), 1)), atol=1e-12
    )


def test_row_14_positions_without_a_surface_are_refused() -> None:
    rest = lattice()[:, :2]
    cases = [
        (rest[:COLS], 0.3, "lie on one line"),
        (np.vstack([rest, rest[4]]), 0.3, "markers 4 and 143 stand at the same place"),
        (np.vstack([rest, [np.nan, 0.0]]), 0.3, "marker 143"),
        (rest, 0.0, "a step of 0 mm"),
        (rest, 1e-5, "4194304"),
    ]
    for positions, step_mm, text in cases:
        with pytest.raises(gelstereo.MeshError, match=text):
            DenseSurface(positions, step_mm)
    surface = DenseSurface(rest, 0.3)
    with pytest.raises(gelstereo.MeshError, match="143 markers"):
        surface.sample(np.zeros(3))
    with pytest.raises(gelstereo.MeshError, match="marker 0 has a coordinate"):
        surface.points(np.full((ROWS * COLS, 3), np.nan))
