"""Foresight sort against a literal transcription of the paper's Algorithm 1, with its slips resolved."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import LabelError, Params, foresight_sort, rest_lattice

PITCH_PX = 17.0


def algorithm_1(positions: np.ndarray, cols: int, tolerance: float) -> np.ndarray | None:
    """Line by line as printed, but from 0, over what is left, each row by abscissa, and None if a row does
    not fill.
    """
    left = sorted(range(len(positions)), key=lambda i: (positions[i][1], positions[i][0]))
    out: list[int] = []
    while left:
        space = left[: 2 * cols]
        row: list[int] = []
        for candidate in space:
            if all(abs(positions[candidate][0] - positions[j][0]) >= tolerance for j in row):
                row.append(candidate)
                left.remove(candidate)
            if len(row) == cols:
                break
        if len(row) < cols:
            return None
        out += sorted(row, key=lambda i: positions[i][0])
    return np.array(out)


def lattice(rows: int, cols: int, degrees: float, jitter_px: float, seed: int) -> np.ndarray:
    """Positions in the order of their labels."""
    y, x = np.mgrid[:rows, :cols].reshape(2, -1) - (np.array([[rows], [cols]]) - 1) / 2
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    noise = np.random.default_rng(seed).uniform(-jitter_px, jitter_px, (rows * cols, 2))
    return np.column_stack([x, y]) * PITCH_PX @ turn + 300.0 + noise


@given(
    st.integers(3, 12), st.integers(3, 12), st.floats(-12, 12), st.floats(0, 2.5), st.integers(0, 2**32 - 1)
)
def test_the_sort_is_the_algorithm(rows: int, cols: int, degrees: float, jitter_px: float, seed: int) -> None:
    ordered = lattice(rows, cols, degrees, jitter_px, seed)
    shuffled = ordered[np.random.default_rng(seed).permutation(len(ordered))]
    expected = algorithm_1(shuffled, cols, PITCH_PX / 3)
    try:
        found = foresight_sort(shuffled, rows, cols, PITCH_PX / 3)
    except LabelError:
        # A refusal is right where the algorithm stalls or its answer is not the lattice.
        assert expected is None or not np.array_equal(shuffled[expected], ordered)
    else:
        assert expected is not None
        assert np.array_equal(found, expected)
        assert np.array_equal(shuffled[found], ordered)


@pytest.mark.parametrize("count", [0, 8, 10])
def test_another_number_of_markers_is_refused(count: int) -> None:
    with pytest.raises(LabelError, match=str(count)):
        foresight_sort(np.zeros((count, 2)), 3, 3, 5.0)


def test_row_16_a_missing_corner_is_filled_in() -> None:
    params = Params().replace(lattice={"rows": 7, "cols": 9})
    ordered = lattice(7, 9, 1.0, 0.0, 0)
    found = rest_lattice(ordered[1:], params)
    assert found.filled.tolist() == [True] + [False] * 62
    # The lattice is regular, so that its neighbours tell the corner exactly, but for round-off.
    assert np.abs(found.positions_px - ordered).max() < 1e-9
    assert found.pitch_px == pytest.approx(PITCH_PX, abs=1e-9)
