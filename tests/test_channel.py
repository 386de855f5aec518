"""Colour images: the channel of `detect.channel`, and the choice of ``"auto"``."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import DATA, needs

import gelstereo as gs

Image = npt.NDArray[np.uint8]
#: Place of each channel in the last axis, as OpenCV reads images.
PLACES = {"blue": 0, "green": 1, "red": 2}


@pytest.fixture(scope="module")
def pair() -> tuple[gs.Rig, Image, Image]:
    simulator = gs.simulate("marker_field")
    frame = simulator[0]
    return simulator.scene.rig, frame.left, frame.right


def coloured(image: Image, seed: int, **shares: float) -> Image:
    """A colour image whose channels show this share of the print's contrast, each with noise of
    two levels.
    """
    random, mean = np.random.default_rng(seed), float(np.median(image))
    channels = []
    for name in PLACES:
        shown = mean + shares[name] * (image.astype(np.float64) - mean)
        channels.append(shown + random.normal(0.0, 2.0, image.shape))
    return np.clip(np.round(np.stack(channels, axis=-1)), 0, 255).astype(np.uint8)


@given(st.integers(0, 1000), st.integers(5, 40), st.integers(5, 40))
@settings(max_examples=40, deadline=None)
def test_grey_is_that_of_opencv(seed: int, height: int, width: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)
    params = gs.Params.preset("paper").replace({"detect.channel": "grey"})
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    try:
        one, other = (gs.Detector(params).mask(each) for each in (image, grey))
    except gs.DetectError:
        return
    assert (one == other).all()


@pytest.mark.parametrize("name", PLACES)
def test_one_channel_is_that_channel(name: str, pair: tuple[gs.Rig, Image, Image]) -> None:
    image = coloured(pair[1], 0, blue=1.0, green=0.8, red=0.6)
    detector = gs.Detector(gs.Params.preset("balanced").replace({"detect.channel": name}))
    found = detector.detect(image)
    alone = detector.detect(np.ascontiguousarray(image[..., PLACES[name]]))
    assert found.channel == name and alone.channel == "grey"
    assert (found.centres_px == alone.centres_px).all()
    wide = np.concatenate([image, image], axis=1)
    assert (detector.detect(wide[:, : image.shape[1]]).centres_px == found.centres_px).all()


@pytest.mark.parametrize("name", PLACES)
@given(seed=st.integers(0, 1000), rest=st.floats(0.0, 0.2))
@settings(max_examples=5, deadline=None)
def test_auto_chooses_the_channel_that_shows_the_print(name: str, seed: int, rest: float) -> None:
    frame = gs.simulate("marker_field")[0]
    shares = {**dict.fromkeys(PLACES, rest), name: 1.0}
    found = gs.Detector(gs.Params.preset("balanced")).detect(coloured(frame.left, seed, **shares))
    whole = gs.Detector(gs.Params.preset("balanced")).detect(frame.left)
    # Green carries most of grey, which may serve as well.
    assert found.channel in ({name, "grey"} if name == "green" else {name})
    assert len(found) == len(whole)


def test_auto_keeps_grey_when_all_channels_show_the_print(pair: tuple[gs.Rig, Image, Image]) -> None:
    same = np.repeat(pair[1][..., None], 3, axis=2)
    found = gs.Detector(gs.Params.preset("balanced")).detect(same)
    alone = gs.Detector(gs.Params.preset("balanced")).detect(pair[1])
    assert found.channel == "grey" and (found.centres_px == alone.centres_px).all()
    noisy = coloured(pair[1], 1, blue=1.0, green=1.0, red=1.0)
    assert gs.Detector(gs.Params.preset("balanced")).detect(noisy).channel == "grey"


def test_pipeline_keeps_the_channel_of_its_rest_frame(pair: tuple[gs.Rig, Image, Image]) -> None:
    rig, *views = pair
    pipeline = gs.Pipeline(rig, gs.Params.preset("balanced"))
    assert pipeline.channel is None
    with pytest.raises(gs.Error):
        pipeline.process(*(np.full((*view.shape, 3), 128, np.uint8) for view in views))
    assert pipeline.channel is None, "a rest frame that fails determines nothing"
    blue = [coloured(view, at, blue=1.0, green=0.05, red=0.05) for at, view in enumerate(views)]
    assert pipeline.process(*blue).left.detected > 100
    assert pipeline.channel == "blue"
    red = [coloured(view, at, blue=0.6, green=0.1, red=1.0) for at, view in enumerate(views)]
    pipeline.process(*red)
    assert pipeline.channel == "blue"
    pipeline.reset()
    assert pipeline.channel is None
    pipeline.process(*red)
    assert pipeline.channel == "red"


def test_pipeline_gives_what_the_channel_alone_gives(pair: tuple[gs.Rig, Image, Image]) -> None:
    rig, *views = pair
    colour = [coloured(view, at, blue=0.7, green=0.9, red=0.2) for at, view in enumerate(views)]
    params = gs.Params.preset("balanced").replace({"detect.channel": "green"})
    one = gs.Pipeline(rig, params).process(*colour)
    other = gs.Pipeline(rig, params).process(*(np.ascontiguousarray(view[..., 1]) for view in colour))
    assert one.digest == other.digest
    assert gs.Pipeline(rig, params).process(*colour, threads=2).digest == one.digest


@pytest.mark.parametrize(
    ("shape", "dtype", "said"),
    [
        ((9, 9, 4), np.uint8, "removes the alpha channel"),
        ((9, 9, 1), np.uint8, r"image\[\.\.\., 0\]"),
        ((9, 9, 3), np.float32, "blue, green and red"),
        ((9,), np.uint8, "valid is a uint8 array"),
    ],
)
def test_other_arrays_are_refused(shape: tuple[int, ...], dtype: type, said: str) -> None:
    with pytest.raises(gs.ImageError, match=said):
        gs.Detector().detect(np.zeros(shape, dtype))


def test_unknown_channels_are_refused() -> None:
    with pytest.raises(gs.ParamsError, match="blue"):
        gs.Params().replace({"detect.channel": "cyan"})


@needs("9dtact_calib")
@pytest.mark.parametrize("name", ["s1_ref.png", "s2_ref.png", "s1_sample.png"])
def test_a_real_colour_image_gives_the_markers_of_its_channel(name: str) -> None:
    image = cv2.imread(str(DATA / "9dtact_calib" / name), cv2.IMREAD_COLOR)
    detector = gs.Detector(gs.Params.preset("balanced"))
    found = detector.detect(np.asarray(image, np.uint8))
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    alone = grey if found.channel == "grey" else image[..., PLACES[found.channel]]
    assert (found.centres_px == detector.detect(np.ascontiguousarray(alone)).centres_px).all()
