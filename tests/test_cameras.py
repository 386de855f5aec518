"""Cameras: conversions against NumPy and OpenCV, names and settings; real drivers are tested in tests/vm."""

from __future__ import annotations

import sys

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import gelstereo as gs

Bytes = npt.NDArray[np.uint8]
LAYOUTS: list[gs.cameras.Layout] = [
    "side_by_side",
    "side_by_side_swapped",
    "interleaved",
    "interleaved_swapped",
]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="cameras are read by Video4Linux2")


@st.composite
def rows(draw: st.DrawFn, bytes_per_pixel: int) -> tuple[Bytes, int, int]:
    """Rows of a driver's frame with padding, and the width and height of the picture in them."""
    width, height = 2 * draw(st.integers(1, 12)), draw(st.integers(1, 9))
    padding = draw(st.integers(0, 5))
    shape = (height, width * bytes_per_pixel + padding)
    return draw(hnp.arrays(np.uint8, shape)), width, height


def views(picture: Bytes, layout: gs.cameras.Layout) -> tuple[Bytes, Bytes]:
    """Both views of a picture whose rows hold them, by NumPy."""
    half = picture.shape[1] // 2
    if layout.startswith("side_by_side"):
        first, second = picture[:, :half], picture[:, half:]
    else:
        first, second = picture[:, 0::2], picture[:, 1::2]
    return (second, first) if layout.endswith("swapped") else (first, second)


@given(rows(1), st.sampled_from(LAYOUTS))
def test_grey_frames_are_split_as_by_numpy(frame: tuple[Bytes, int, int], layout: gs.cameras.Layout) -> None:
    data, width, height = frame
    found = gs.cameras.decode(
        data.tobytes(), format="grey", size_px=(width, height), layout=layout, stride=data.shape[1]
    )
    np.testing.assert_array_equal(found, views(data[:, :width], layout))
    assert not found[0].flags.writeable


@given(rows(2), st.sampled_from(LAYOUTS))
def test_yuyv_frames_are_luma_as_by_opencv(frame: tuple[Bytes, int, int], layout: gs.cameras.Layout) -> None:
    data, width, height = frame
    found = gs.cameras.decode(
        data.tobytes(), format="yuyv", size_px=(width, height), layout=layout, stride=data.shape[1]
    )
    picture = np.ascontiguousarray(data[:, : 2 * width])
    if layout.startswith("side_by_side"):
        picture = cv2.cvtColor(picture.reshape(height, width, 2), cv2.COLOR_YUV2GRAY_YUYV)
        assert picture.dtype == np.uint8
    np.testing.assert_array_equal(found, views(picture.astype(np.uint8), layout))


@given(rows(2), st.booleans())
def test_two_8_bit_views_in_16_bit_pixels_are_told_apart(
    frame: tuple[Bytes, int, int], swapped: bool
) -> None:
    data, width, height = frame
    layout: gs.cameras.Layout = "interleaved_swapped" if swapped else "interleaved"
    found = gs.cameras.decode(
        data.tobytes(), format="y16", size_px=(width, height), layout=layout, stride=data.shape[1]
    )
    pixels = np.ascontiguousarray(data[:, : 2 * width]).view("<u2")
    low, high = (pixels & 255).astype(np.uint8), (pixels >> 8).astype(np.uint8)
    np.testing.assert_array_equal(found, (high, low) if swapped else (low, high))


def textured(width: int, height: int, seed: int = 0) -> Bytes:
    noise = np.random.default_rng(seed).integers(0, 256, (height // 4 + 1, width // 4 + 1), np.uint8)
    return np.asarray(cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


def jpeg(picture: Bytes, quality: int = 90) -> bytes:
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return data.tobytes()


@pytest.mark.parametrize("layout", LAYOUTS[:2])
@pytest.mark.parametrize("size", [(640, 240), (62, 37), (1280, 480)])
@pytest.mark.parametrize("colour", [False, True])
def test_jpeg_frames_are_luma_as_by_opencv(
    layout: gs.cameras.Layout, size: tuple[int, int], colour: bool
) -> None:
    picture = textured(*size)
    data = jpeg(np.dstack([picture, np.roll(picture, 9, 1), picture[::-1]]) if colour else picture)
    found = gs.cameras.decode(data, format="mjpg", size_px=size, layout=layout)
    expected = views(np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)), layout)
    for view, other in zip(found, expected, strict=True):
        # The inverse transforms of two decoders may round differently.
        assert np.abs(view.astype(int) - other.astype(int)).max() <= 2
    padded = gs.cameras.decode(data + bytes(1000), format="mjpg", size_px=size, layout=layout)
    np.testing.assert_array_equal(padded, found)


@given(st.data())
def test_no_cut_or_damaged_jpeg_passes_for_an_image_of_another_size(data: st.DataObject) -> None:
    whole = jpeg(textured(64, 32))
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(gs.ImageError, match="JPEG"):
        gs.cameras.decode(cut, format="mjpg", size_px=(64, 32))
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    try:
        left, right = gs.cameras.decode(bytes(broken), format="mjpg", size_px=(64, 32))
    except gs.ImageError:
        return
    assert left.shape == right.shape == (32, 32)


def test_frames_that_do_not_fit_say_so() -> None:
    with pytest.raises(gs.ImageError, match="holds 7 bytes, but the shape and stride need 8"):
        gs.cameras.decode(bytes(7), format="grey", size_px=(4, 2))
    with pytest.raises(gs.ImageError, match="64 x 32 pixels, but the camera's format is 64 x 48"):
        gs.cameras.decode(jpeg(textured(64, 32)), format="mjpg", size_px=(64, 48))
    with pytest.raises(gs.CameraError, match="JPEG mixes neighbours"):
        gs.cameras.decode(b"", format="mjpg", size_px=(64, 48), layout="interleaved")
    with pytest.raises(gs.CameraError, match="layout must be interleaved"):
        gs.cameras.decode(b"", format="y16", size_px=(64, 48))
    with pytest.raises(gs.CameraError, match="even width"):
        gs.cameras.decode(b"", format="grey", size_px=(63, 48))
    with pytest.raises(gs.CameraError, match=r"expected one of .*mjpg.*yuyv"):
        gs.cameras.decode(b"", format="rgb", size_px=(64, 48))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"device": "0"}, 'device is "0"; valid is serial: and the USB serial number, or a path'),
        ({"device": "/dev/no-such-video"}, "there is no camera /dev/no-such-video; connected are: "),
        ({"device": "serial:no such number"}, "there is no camera serial:no such number; connected are: "),
        ({"device": "/dev/null"}, "/dev/null is no video node"),
        ({"frame_rate_hz": 0}, "frame_rate_hz is 0; valid is 0.1 to 1000 Hz"),
        ({"frame_rate_hz": float("nan")}, "frame_rate_hz is NaN"),
        ({"size_px": (0, 480)}, "size_px is"),
        ({"size_px": (1279, 480)}, "even width"),
        ({"layout": "above"}, "unknown variant `above`, expected one of `side_by_side`"),
        ({"right_device": "/dev/video0"}, "right_device is /dev/video0; valid is another device"),
        (
            {"right_device": "/dev/video9", "max_skew_ms": 20.0},
            "max_skew_ms is 20; valid is at most half a frame's period",
        ),
        ({"buffers": 1}, "buffers is 1; valid is 2 to 32 frames"),
        ({"queue_frames": 0}, "queue_frames is 0"),
        ({"stall_timeout_ms": 20}, "at least two frames' periods"),
        ({"min_retry_ms": 500, "max_retry_ms": 200}, "max_retry_ms is 200; valid is at least min_retry_ms"),
        ({"exposure_us": -1.0}, "controls.exposure_us is -1; valid is 100 to 10000000 us"),
        ({"exposure_us": 100.0, "auto_exposure": True}, "false, or no exposure_us"),
        ({"controls": {"sharpness": 0.5}}, "sharpness"),
        ({"timeout_s": -1.0}, "timeout_s is -1; valid is 0 to 3600 s"),
    ],
)
def test_settings_and_names_are_checked(settings: dict[str, object], words: str) -> None:
    with pytest.raises(gs.CameraError) as caught:
        gs.cameras.open(**{"device": "/dev/video0"} | settings)  # type: ignore[arg-type]
    assert words in str(caught.value)
    assert isinstance(caught.value, gs.Error)


def test_the_list_names_nodes() -> None:
    for camera in gs.cameras.list():
        assert camera.path.startswith("/dev/video")
