"""Parts by their dimensions are closed, look outwards and have the size that they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import MeshError, parts

ALL = {**parts.PEGS, **parts.CONTACTS}


@pytest.mark.parametrize("name", ALL)
def test_every_part_is_one_closed_body_that_a_hand_holds(name):
    mesh = ALL[name]()
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume > 0.0
    assert 5.0 < mesh.extents.max() < 60.0
    # The origin lies on the axis, in the plane that the part stands on.
    assert mesh.bounds[0][2] == pytest.approx(0.0, abs=1e-12)
    assert np.all(mesh.bounds[0][:2] < 0.0) and np.all(mesh.bounds[1][:2] > 0.0)


def test_dimensions_are_those_asked_for():
    assert parts.peg_square(side_mm=6.0, length_mm=30.0).extents == pytest.approx([6.0, 6.0, 30.0])
    assert parts.peg_hexagonal(across_flats_mm=7.0).extents[1] == pytest.approx(7.0)
    assert parts.usb_plug().bounds[1] == pytest.approx([7.5, 3.75, 33.75])
    screw = parts.screw_m10()
    outer_mm = np.linalg.norm(screw.vertices[:, :2], axis=1)
    thread = outer_mm[(screw.vertices[:, 2] > 6.5) & (outer_mm > 1.0)]  # not the middle of its end
    assert thread.max() == pytest.approx(5.0)
    assert 4.07 < thread.min() < 4.2  # root by ISO 68-1: 5 - 0.6134 x 1.5 mm


@given(
    corners=st.integers(3, 40),
    radius_mm=st.floats(0.1, 50.0),
    heights_mm=st.lists(st.floats(0.1, 10.0), min_size=1, max_size=6),
)
def test_a_straight_loft_has_the_volume_of_a_prism(corners, radius_mm, heights_mm):
    outline = parts.polar(radius_mm, corners)
    levels = np.concatenate([[0.0], np.cumsum(heights_mm)])
    mesh = parts.loft([(level, outline) for level in levels])
    area = 0.5 * corners * radius_mm**2 * np.sin(2.0 * np.pi / corners)
    assert mesh.volume == pytest.approx(area * levels[-1], rel=1e-9)
    assert mesh.area == pytest.approx(
        2 * area + 2 * corners * radius_mm * np.sin(np.pi / corners) * levels[-1], rel=1e-9
    )


def test_a_thread_advances_by_its_pitch():
    mesh = parts.screw_m10()
    crests = mesh.vertices[np.linalg.norm(mesh.vertices[:, :2], axis=1) > 4.999]
    crests = crests[crests[:, 2] > 6.5]
    turns = np.arctan2(crests[:, 1], crests[:, 0]) / (2.0 * np.pi)
    phase = ((crests[:, 2] - 6.4) / 1.5 - turns) % 1.0
    # A crest is an eighth of the pitch wide; a flank falls by 0.92 mm over 5/16 of it.
    assert np.all(np.minimum(phase, 1.0 - phase) < 0.0625 + 0.3125 * 0.001 / 0.92 + 1e-6)


@pytest.mark.parametrize(
    ("rings", "said"),
    [
        ([(0.0, [[0, 0], [1, 0], [0, 1]])], "two or more"),
        ([(0.0, [[0, 0], [1, 0]]), (1.0, [[0, 0], [1, 0]])], "at least 3"),
        ([(0.0, [[0, 0], [1, 0], [0, 1]]), (1.0, [[0, 0], [1, 0], [1, 1], [0, 1]])], "one shape"),
        ([(0.0, [[0, 0], [0, 1], [1, 0]]), (1.0, [[0, 0], [0, 1], [1, 0]])], "counter-clockwise"),
    ],
)
def test_rings_that_enclose_nothing_are_refused(rings, said):
    with pytest.raises(MeshError, match=said):
        parts.loft([(height, np.array(outline, float)) for height, outline in rings])


def test_outlines_that_do_not_share_out_are_refused():
    with pytest.raises(MeshError, match="multiple"):
        parts.regular(6, 8.0, 20)
    with pytest.raises(MeshError, match="multiple"):
        parts.rectangle(2.0, 1.0, 6)
