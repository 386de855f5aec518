"""Prints of other makers: wider than the view, in perspective, or no square lattice. Discs drawn by NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gelstereo as gs

WIDTH_PX, HEIGHT_PX = 640, 480
GEL, DOT = 170.0, 60.0
RADIUS_PX = 5.0


def lattice(rows: int, cols: int, pitch_px: float, degrees: float, shear: float = 0.0) -> np.ndarray:
    """(rows, cols, 2) positions about the middle of the image; `shear` moves every other row along itself."""
    row, col = np.mgrid[:rows, :cols].astype(float)
    col += shear * (row % 2)
    at = np.stack([col - (cols - 1) / 2, row - (rows - 1) / 2], axis=-1) * pitch_px
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(at @ turn + [WIDTH_PX / 2, HEIGHT_PX / 2])


def perspective(positions: np.ndarray, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions seen under a tilt, and the scale of each."""
    from_middle = positions - [WIDTH_PX / 2, HEIGHT_PX / 2]
    scale = 1.0 / (1.0 - tilt * from_middle[..., 1] / 500.0)
    return from_middle * scale[..., None] + [WIDTH_PX / 2, HEIGHT_PX / 2], scale


def draw(
    positions: np.ndarray, scale: np.ndarray | float = 1.0, level: np.ndarray | float = DOT, seed: int = 0
) -> np.ndarray:
    """Discs with edges 1.4 px wide, and noise of 2 grey levels."""
    image = np.full((HEIGHT_PX, WIDTH_PX), GEL)
    at = positions.reshape(-1, 2)
    radius = np.broadcast_to(np.ravel(scale), len(at)) * RADIUS_PX
    levels = np.broadcast_to(np.ravel(level), len(at))
    for (x, y), r, dot in zip(at, radius, levels, strict=True):
        left, right = (int(np.clip(v, 0, WIDTH_PX)) for v in (x - r - 3, x + r + 4))
        top, bottom = (int(np.clip(v, 0, HEIGHT_PX)) for v in (y - r - 3, y + r + 4))
        rows, cols = np.mgrid[top:bottom, left:right]
        cover = np.clip((r + 0.7 - np.hypot(cols - x, rows - y)) / 1.4, 0.0, 1.0)
        part = image[top:bottom, left:right]
        part += cover * (dot - part)
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(image + noise, 0.0, 255.0).astype(np.uint8)


def labelled(image: np.ndarray, **lattice: Any) -> gs.RestLattice:
    params = gs.Params.preset("balanced").replace(lattice=lattice)
    return gs.rest_lattice(gs.Detector(params).detect(image).centres_px, params)


def is_part(rest: gs.RestLattice, truth: np.ndarray) -> bool:
    """Whether the detected markers have the labels of the truth, up to turn and shift."""
    grid = rest.positions_px.reshape(rest.rows, rest.cols, 2)
    seen = ~rest.filled.reshape(rest.rows, rest.cols)
    for turns in range(4):
        turned, there = np.rot90(grid, turns), np.rot90(seen, turns)
        row, col = np.argwhere(there)[0]
        off = np.linalg.norm(truth - turned[row, col], axis=-1)
        top, left = np.array(np.unravel_index(off.argmin(), off.shape)) - (row, col)
        if min(top, left) < 0 or top + len(turned) > len(truth) or left + turned.shape[1] > truth.shape[1]:
            continue
        part = truth[top : top + len(turned), left : left + turned.shape[1]]
        if np.linalg.norm(part - turned, axis=-1)[there].max() < 0.5:
            return True
    return False


@pytest.mark.parametrize("degrees", [0.0, 3.0, 10.0, 30.0, 45.0])
def test_row_51_prints_wider_than_the_view(degrees: float) -> None:
    truth = lattice(60, 60, 20.0, degrees)
    image = draw(truth)
    rest = labelled(image, max_missing_share=0.01)
    assert is_part(rest, truth)
    assert rest.filled.sum() <= round(0.01 * rest.rows * rest.cols)
    # About 740 markers are whole. Turned by 45 degrees, 0.4 of them lie in a rectangle.
    assert (~rest.filled).sum() > 300
    assert any(rest.left_out) == (degrees > 0.0)
    smaller = labelled(image, rows=9, cols=12)
    assert (smaller.rows, smaller.cols) == (9, 12)
    assert is_part(smaller, truth) and not smaller.filled.any()


@pytest.mark.parametrize("tilt", [0.4, 0.8])
def test_row_51_a_faint_far_side(tilt: float) -> None:
    truth, scale = perspective(lattice(22, 23, 17.0, 2.0), tilt)
    # Contrast falls with the square of the distance, to a fifth of that in the middle.
    level = GEL - (GEL - DOT) * np.clip(scale, 0.45, 1.0) ** 2
    rest = labelled(draw(truth, scale, level))
    assert is_part(rest, truth)
    inside = ((truth > 10.0) & (truth < [WIDTH_PX - 10.0, HEIGHT_PX - 10.0])).all(axis=-1).sum()
    assert inside > 450
    assert (~rest.filled).sum() > 0.85 * inside


@pytest.mark.parametrize("degrees", [0.0, 5.0, 20.0])
def test_row_52_other_layouts_are_named(degrees: float) -> None:
    hexagonal = lattice(50, 50, 22.0, 0.0, 0.5) - [WIDTH_PX / 2, HEIGHT_PX / 2]
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    hexagonal = hexagonal * [1.0, np.sqrt(0.75)] @ turn + [WIDTH_PX / 2, HEIGHT_PX / 2]
    with pytest.raises(gs.LabelError, match="six neighbours"):
        labelled(draw(hexagonal))
    with pytest.raises(gs.LabelError, match="the print is rectangular"):
        labelled(draw(lattice(50, 50, 20.0, degrees)[:, ::2]))
    rng = np.random.default_rng(int(degrees))
    dots: list[np.ndarray] = []
    while len(dots) < 250:
        at = rng.uniform([10.0, 10.0], [WIDTH_PX - 10.0, HEIGHT_PX - 10.0])
        if all(np.hypot(*(at - dot)) > 14.0 for dot in dots):
            dots.append(at)
    with pytest.raises(gs.LabelError, match="spacing is unequal"):
        labelled(draw(np.array(dots)))
