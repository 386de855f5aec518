"""Nearest samples of a template, against every distance and SciPy's cKDTree; of equally near ones
the first.
"""

from __future__ import annotations

from pathlib import Path

import hypothesis.extra.numpy as hnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gelstereo import Template
from gelstereo.geometry import nearest, shape_mesh

EPS = float(np.finfo(float).eps)

#: Lattices, whose halves are as near to up to eight points, and anything between.
coordinates = st.one_of(st.integers(-6, 6).map(lambda k: 0.5 * k), st.floats(-3.0, 3.0))
rows = st.integers(1, 150).flatmap(lambda n: hnp.arrays(float, (n, 3), elements=coordinates))
#: So that the extent is a part's, whatever else is drawn.
CORNERS = np.array([[-3.0, -3.0, -3.0], [3.0, 3.0, 3.0], [3.0, -3.0, 0.0]])


def scan(points_mm: np.ndarray) -> Template:
    normals = np.random.default_rng(len(points_mm)).normal(size=points_mm.shape)
    return Template.from_points(points_mm, normals, 1.0)


def squares(points: np.ndarray, queries: np.ndarray) -> np.ndarray:
    """Squared distances (M, N), added in the tree's order, so that what is a tie there is one here."""
    d = queries[:, None, :] - points[None, :, :]
    out: np.ndarray = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    return out


@given(rows, rows)
def test_row_12_nearest_samples_are_those_of_every_distance_and_scipys(
    points: np.ndarray, queries: np.ndarray
) -> None:
    points = np.vstack([points, CORNERS])
    template = scan(points)
    indices, distances_mm = template.nearest(queries)
    every = squares(points, queries)
    assert np.array_equal(indices, every.argmin(axis=1))  # argmin takes the first of equals
    assert np.array_equal(distances_mm, np.sqrt(every.min(axis=1)))
    theirs, names = cKDTree(points).query(queries)
    # Both sum three squares and take a root, in another order: two roundings of the sum, halved by the root,
    # and the root's own. Squares that underflow lose all digits, below 1e-160 mm.
    np.testing.assert_allclose(distances_mm, theirs, rtol=3 * EPS, atol=1e-160)
    # Where nothing else is as near to SciPy's rounding, it names the same one.
    alone = (every <= every.min(axis=1)[:, None] * (1.0 + 8.0 * EPS) + 1e-300).sum(axis=1) == 1
    assert np.array_equal(indices[alone], names[alone])


@given(rows, st.integers(1, 40))
def test_a_template_is_asked_again_and_answers_alike(queries: np.ndarray, count: int) -> None:
    template = Template.from_triangles(*shape_mesh({"kind": "box", "size_mm": [4, 5, 6]}), spacing_mm=0.5)
    indices, distances_mm = template.nearest(queries)
    assert indices.dtype == np.int64
    assert indices.shape == distances_mm.shape == (len(queries),)
    once = nearest(template.points_mm, queries)
    assert np.array_equal(indices, once[0])
    assert np.array_equal(distances_mm, once[1])
    some = template.nearest(queries[:count])
    assert np.array_equal(indices[:count], some[0])
    assert np.array_equal(distances_mm[:count], some[1])


def test_nearest_samples_of_many_and_none_and_of_a_file(tmp_path: Path) -> None:
    template = Template.from_triangles(*shape_mesh({"kind": "sphere", "radius_mm": 5.0}), spacing_mm=0.5)
    queries = np.random.default_rng(1).uniform(-7.0, 7.0, size=(2000, 3))
    distances_mm, names = cKDTree(template.points_mm).query(queries)
    assert np.array_equal(template.nearest(queries)[0], names)
    np.testing.assert_allclose(template.nearest(queries)[1], distances_mm, rtol=3 * EPS)
    assert [len(found) for found in template.nearest(np.empty((0, 3)))] == [0, 0]
    template.save(tmp_path / "ball.template")
    again = Template.load(tmp_path / "ball.template").nearest(queries)
    assert np.array_equal(again[0], names)
