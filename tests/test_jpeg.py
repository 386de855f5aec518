"""The simulator's compression against OpenCV's codec: the same tables, the same pixels but for derived
rounding.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from gelstereo import Scene, Simulator

Image = npt.NDArray[np.uint8]

SCENE = {
    "gel": {"dark_level": 10, "bright_level": 245},
    "indenter": {"kind": "sphere", "radius_mm": 4.0},
    "trajectory": [{"time_s": 0.0, "position_mm": [4.0, 0.0, 31.5]}],
    "effects": {"grain": {"sigma_levels": 12.0}, "sensor_noise": {"sigma_levels": 6.0}, "uneven_light": {}},
}


def seen(quality: int | None, seed: int = 1, size: tuple[int, int] = (640, 480)) -> Image:
    """Left image of a noisy gel, compressed or not; noise comes from streams of its own and is the same."""
    scene = Scene().replace(SCENE, seed=seed)
    effects = dict(SCENE["effects"], **({} if quality is None else {"jpeg": {"quality": quality}}))
    camera = {"width_px": size[0], "height_px": size[1]}
    return Simulator(scene.replace(effects=effects, rig={"left": camera, "right": camera}))[0].left


def encoded(image: Image, quality: int) -> Image:
    """The file that OpenCV writes: one component, 4:0:0."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 0]
    return cv2.imencode(".jpg", image, flags)[1]


def steps(file: Image) -> npt.NDArray[np.int64]:
    """(8, 8) the quantisation table of a file: its segment DQT lists it along the zigzag (T.81, B.2.4.1)."""
    data = file.tobytes()
    at = data.index(b"\xff\xdb")
    assert data[at + 4] == 0, "8-bit steps, table 0"
    diagonals = sorted(
        ((row, column) for row in range(8) for column in range(8)),
        key=lambda cell: (sum(cell), cell[0] if sum(cell) % 2 else cell[1]),
    )
    table = np.zeros((8, 8), dtype=np.int64)
    for (row, column), step in zip(diagonals, data[at + 5 : at + 69], strict=True):
        table[row, column] = step
    return table


def blocks(image: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
    """(rows, columns, 8, 8) its blocks; those that reach beyond it are filled up with its last pixels."""
    padded = np.pad(image, [(0, -side % 8) for side in image.shape], mode="edge")
    high, wide = (side // 8 for side in padded.shape)
    return padded.reshape(high, 8, wide, 8).swapaxes(1, 2)


def cosines() -> npt.NDArray[np.float64]:
    """T.81, A.3.3: row u is c(u) / 2 cos((2 x + 1) u pi / 16)."""
    u, x = np.mgrid[:8, :8]
    return np.where(u == 0, np.sqrt(0.125), 0.5) * np.cos((2 * x + 1) * u * np.pi / 16)


def amplitudes(image: Image) -> npt.NDArray[np.float64]:
    """(rows, columns, 8, 8) the blocks' cosines in floating point."""
    return cosines() @ (blocks(image).astype(float) - 128) @ cosines().T


#: An amplitude so near to the middle between two steps may be rounded either way. Both codecs count in
#: integers: ours with cosines off by 2^-14 / sqrt(3) and 1/16 levels between its passes, libjpeg's with 1/8.
#: Over 64 pixels of some 60 levels that is 0.02, 0.03 and 0.05 levels rms, 0.06 in all, and these are five of
#: it.
DOUBT = 0.3


def check(plain: Image, found: Image, quality: int) -> None:
    """Every pixel is within what the amplitudes in doubt of its block may change, and rounding."""
    file = encoded(plain, quality)
    expected = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE)
    assert expected.shape == found.shape
    table = steps(file)
    parts = amplitudes(plain) / table
    beside = np.abs(parts - np.floor(parts) - 0.5) * table < DOUBT
    # One that ends a step apart changes a pixel by c(u) c(v) / 4 of the step at most. Both round to levels at
    # the end.
    scale = np.where(np.arange(8) == 0, np.sqrt(0.5), 1.0)
    allowed = 1.0 + (beside * np.outer(scale, scale) * table / 4).sum(axis=(2, 3))
    difference = blocks(np.abs(found.astype(int) - expected)).max(axis=(2, 3))
    assert (difference <= allowed).all(), (difference - allowed).max()
    # At low quality hardly anything is in doubt, and images are the same but for rounding.
    clear = ~beside.any(axis=(2, 3))
    assert quality > 50 or clear.mean() > 0.1
    assert (difference[clear] <= 1).all()


@pytest.mark.parametrize("quality", [5, 25, 49, 50, 75, 90, 95, 100])
def test_pixels_are_those_of_opencv(quality: int) -> None:
    check(seen(None), seen(quality), quality)


@pytest.mark.parametrize("size", [(637, 475), (633, 473)])
def test_borders_within_a_block_are_those_of_opencv(size: tuple[int, int]) -> None:
    check(seen(None, 3, size), seen(40, 3, size), 40)
