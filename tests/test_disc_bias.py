"""The bias of a tilted disc's image, in closed form, against the outline traced by another camera model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import Rig, ShapeError, TriangulateError, disc_bias
from gelstereo.geometry import se3_exp

Floats = npt.NDArray[np.float64]

F_PX, CENTRE_PX = np.array([560.0, 570.0]), np.array([325.0, 236.0])
POSES = (np.eye(4), np.array(se3_exp([0.01, -0.08, 0.02, 0, 0, 0])))
POSES[1][:3, 3] = [-8.0, 0.2, -0.1]


def pixels(points_mm: Floats, pose: Floats, lens: tuple[float, ...]) -> Floats:
    """Pinhole and lens (k1, k2, p1, p2) as in their textbooks."""
    x, y, z = pose[:3, :3] @ points_mm.T + pose[:3, 3:]
    x, y = x / z, y / z
    k1, k2, p1, p2 = lens
    square = x**2 + y**2
    radial = 1 + k1 * square + k2 * square**2
    bent = [
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
        y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
    ]
    return np.array(np.transpose(bent) * F_PX + CENTRE_PX)


def outline_centroid(disc: tuple[Floats, Floats, Floats], pose: Floats, lens: tuple[float, ...]) -> Floats:
    """Centroid of a polygon of 2048 points of the outline: its area is short by 2e-6 of itself."""
    centre, along, across = disc
    angle = np.linspace(0.0, 2.0 * np.pi, 2048, endpoint=False)[:, None]
    rim = pixels(centre + np.cos(angle) * along + np.sin(angle) * across, pose, lens)
    origin = pixels(centre[None], pose, lens)[0]
    p, q = rim - origin, np.roll(rim - origin, -1, axis=0)
    doubled = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return np.array(((p + q) * doubled[:, None]).sum(axis=0) / (3.0 * doubled.sum()))


@given(
    st.tuples(st.floats(-6, 10), st.floats(-6, 6), st.floats(25, 32)),
    st.tuples(*[st.floats(-0.7, 0.7)] * 3),
    st.floats(0.1, 0.4),
    st.floats(0.7, 1.3),
    st.tuples(st.floats(-0.2, 0.2), st.floats(0, 0.05), *[st.floats(-2e-3, 2e-3)] * 2),
)
def test_it_is_the_outlines_centroid(
    centre: tuple[float, ...],
    turn: tuple[float, ...],
    radius_mm: float,
    stretch: float,
    lens: tuple[float, ...],
) -> None:
    matrix = np.array([[F_PX[0], 0, CENTRE_PX[0]], [0, F_PX[1], CENTRE_PX[1]], [0, 0, 1]])
    rig = Rig.from_opencv(
        size_px=(640, 480),
        left_matrix=matrix,
        left_distortion=lens,
        right_matrix=matrix,
        right_distortion=lens,
        rotation=POSES[1][:3, :3],
        translation_mm=POSES[1][:3, 3],
    )
    axes = np.array(se3_exp([*turn, 0, 0, 0]))[:3, :3]
    disc = np.array(centre), axes[:, 0] * radius_mm * stretch, axes[:, 1] * radius_mm
    found = disc_bias(rig, *(part[None] for part in disc))
    # Left out is the fourth order of the disc's size over its depth; the polygon adds round-off.
    bound = F_PX[1] * 4.0 * (1.3 * radius_mm / 25.0) ** 4 + 1e-9
    for bias, pose in zip(found, POSES, strict=True):
        assert np.abs(bias[0] - outline_centroid(disc, pose, lens)).max() < bound


def test_what_is_no_disc() -> None:
    rig = Rig.parallel((640, 480), 560.0, 8.0)
    with pytest.raises(ShapeError, match="1 centres but 2 and 1"):
        disc_bias(rig, [[0, 0, 1.0]], [[0, 0, 1.0]] * 2, [[0, 0, 1.0]])
    with pytest.raises(TriangulateError, match=r"disc 0: .*not in front"):
        disc_bias(rig, [[0, 0, -1.0]], [[0.1, 0, 0]], [[0, 0.1, 0]])
