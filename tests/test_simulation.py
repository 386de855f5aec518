"""The simulated sensor from Python: against Snell's law and the images themselves in NumPy."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo
from gelstereo import Scene, SceneError, Sight, SimulatedFrame, Simulator, Stick

Array = npt.NDArray[np.float64]

REFRACTION = Scene.preset("640x480-25-refraction")
PRESS = {
    "indenter": {"kind": "sphere", "radius_mm": 4.0},
    "trajectory": [{"time_s": 0.0, "position_mm": [5.0, 0.0, 30.8]}],
}


def through_layers(pixels: Array, camera_x_mm: float, depths_mm: Array) -> Array:
    """Follow light from a camera at (x, 0, 0) through air, acrylic and gel, by the vector form of Snell's
    law.
    """
    rays = np.column_stack(((pixels - (319.5, 239.5)) / 600.0, np.ones(len(pixels))))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = np.zeros_like(rays) + (camera_x_mm, 0.0, 0.0)
    ends = (np.full(len(rays), 20.0), np.full(len(rays), 23.0), depths_mm)
    for index, (end, ratio) in enumerate(zip(ends, (1 / 1.49, 1.49 / 1.41, None), strict=True)):
        points = points + rays * ((end - points[:, 2]) / rays[:, 2])[:, None]
        if ratio is not None:
            cosine = rays[:, 2]
            along = np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
            rays = ratio * rays + along[:, None] * (0.0, 0.0, 1.0)
        assert index < 3
    return points


def test_markers_are_seen_where_light_through_the_layers_goes() -> None:
    frame = Simulator(REFRACTION.replace(PRESS))[0]
    assert frame.indentation_mm.max() > 1.1
    for pixels, x in ((frame.left_px, 0.0), (frame.right_px, 10.0)):
        reached = through_layers(pixels, x, frame.points_mm[:, 2])
        # Newton's method ends below 1e-12 of the slope; 1e-11 mm is round-off over 30 mm.
        assert np.abs(reached - frame.points_mm).max() < 1e-10


@pytest.mark.parametrize(
    "scene", [REFRACTION.replace(PRESS), Scene.preset("1280x960-71")], ids=["layers", "dense"]
)
def test_dots_are_drawn_where_truth_says(scene: Scene) -> None:
    frame = Simulator(scene)[0]
    for image, dots in ((frame.left, frame.left_dots), (frame.right, frame.right_dots)):
        ink = (170.0 - image) / 120.0
        reach = int(np.ceil(dots.radii_px.max() * 1.15)) + 1
        for centre, radius in zip(dots.centres_px, dots.radii_px, strict=True):
            column, row = np.rint(centre).astype(int)
            window = ink[row - reach : row + reach + 1, column - reach : column + reach + 1]
            y, x = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
            found = np.array([(window * x).sum(), (window * y).sum()]) / window.sum()
            # Half a level of 120 on the border's 2 pi r pixels, r from the centre, 0.64 on average along an
            # axis.
            assert (
                np.abs(found - centre).max()
                < 2 * np.pi * radius * radius * 0.64 / 240 / (np.pi * radius**2) * 1.5
            )
            assert window.sum() == pytest.approx(np.pi * radius**2, abs=2 * np.pi * radius / 240 * 1.5)


def test_contrast_is_what_the_image_shows() -> None:
    light = {"gain": 0.35, "across": 0.2, "corner_loss": 0.3}
    scene = Scene().replace(
        {"gel": {"dark_level": 100, "bright_level": 240}, "effects": {"uneven_light": light}}
    )
    frame = Simulator(scene)[0]
    for image, dots in ((frame.left, frame.left_dots), (frame.right, frame.right_dots)):
        column, row = np.rint(dots.centres_px).astype(int).T
        beside = (column[1:] + column[:-1]) // 2
        dark, bright = image[row, column].astype(float)[1:], image[row[1:], beside].astype(float)
        inner = np.arange(1, 625) % 25 > 0
        # Rounding of both, and the light that changes by 0.04 levels per pixel over half a pitch.
        assert np.abs((bright - dark) - dots.contrast_levels[1:])[inner].max() < 2.0
        assert dots.contrast_levels[24] > dots.contrast_levels[0], "more light on the right"


def test_normals_are_the_balls() -> None:
    frame = Simulator(REFRACTION.replace(PRESS))[0]
    away = frame.points_mm - (5.0, 0.0, 30.8)
    expected = away / np.linalg.norm(away, axis=1, keepdims=True)
    inner = frame.in_contact & (np.hypot(away[:, 0], away[:, 1]) < 1.4)
    assert inner.sum() >= 12
    # Central differences over two pitches of 0.65 mm on a ball of 4 mm: h'''h^2/6 is 0.017 at a slope of
    # 0.37.
    assert np.abs(frame.normals - expected)[inner].max() < 0.03
    assert np.allclose(np.linalg.norm(frame.normals, axis=1), 1.0)


def test_dropped_frames_are_missing_from_the_sequence() -> None:
    scene = Scene().replace(
        {
            "effects": {"dropped_frames": {"frames": [1, 2]}, "sensor_noise": {}},
            "gel_motion": [{"time_s": 0.0}, {"time_s": 0.2, "shift_mm": [1.0, 0.0]}],
        }
    )
    simulator = Simulator(scene)
    frames = [simulator[index] for index in range(len(simulator))]
    assert isinstance(simulator, Iterable)
    assert [frame.index for frame in simulator] == [frame.index for frame in frames] == [0, 3, 4, 5, 6]
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.1, 4 / 30, 5 / 30, 0.2])
    assert frames[1].points_mm[0, 0] - frames[0].points_mm[0, 0] == pytest.approx(0.5)
    with pytest.raises(IndexError, match="the scene has 5"):
        Simulator(scene)[5]


@pytest.mark.parametrize("effect", ["misprint", "elastic_layer", "motion_blur"])
def test_what_is_read_late_is_what_was_there(effect: str) -> None:
    gel_motion = [{"time_s": 0.0}, {"time_s": 1.0, "shift_mm": [1.0, 0.5], "rotation_rad": 0.1}]
    settings = {"exposure_s": 0.01} if effect == "motion_blur" else {}
    effects = {effect: settings, "sensor_noise": {}, "specks": {"count": 3}}
    scene = REFRACTION.replace({**PRESS, "effects": effects, "gel_motion": gel_motion})
    seen = ("points_mm", "left_px", "right_px", "normals", "left", "right")
    dots = ("centres_px", "half_px", "radii_px", "contrast_levels", "sight", "specks_px", "motion_px")

    def all_of(frame: SimulatedFrame) -> list[Array]:
        looks = [getattr(view, name) for view in (frame.left_dots, frame.right_dots) for name in dots]
        return [*(getattr(frame, name) for name in seen), *looks]

    simulator, late = Simulator(scene), Simulator(scene)
    at_once = [all_of(simulator[index]) for index in (0, 12, 24)]
    frames = [late[index] for index in (0, 12, 24)]
    # Images first, the last frame first: neither order plays a part.
    images = [frame.right for frame in reversed(frames)]
    assert len(images) == 3
    for expected, frame in zip(at_once, frames, strict=True):
        for before, after in zip(expected, all_of(frame), strict=True):
            np.testing.assert_array_equal(before, after)
    assert not np.array_equal(at_once[0][0], at_once[2][0])
    assert frames[0].left is frames[0].left
    moves = np.abs(frames[1].left_dots.motion_px).max()
    assert moves > 0.05 if effect == "motion_blur" else moves == 0.0


def test_a_frame_may_be_read_by_many_threads() -> None:
    simulator = Simulator(Scene().replace(PRESS))
    frame = simulator[0]
    with ThreadPoolExecutor(8) as threads:
        images = list(threads.map(lambda _: frame.left.tobytes(), range(32)))
    assert set(images) == {simulator[0].left.tobytes()}


def test_points_alone_are_not_paid_for_as_images_are() -> None:
    simulator, pose = Simulator(Scene().replace(PRESS)), np.eye(4)
    pose[:3, 3] = (4.0, 0.0, 31.5)

    def least_s(read: Callable[[SimulatedFrame], object]) -> float:
        times = []
        for _ in range(20):
            start = time.perf_counter()
            read(simulator.press(pose))
            times.append(time.perf_counter() - start)
        return min(times)

    points = least_s(lambda frame: frame.points_mm)
    # It is a hundredth and a quarter; machines under load measure badly.
    assert points < 0.1 * least_s(lambda frame: frame.left)
    assert points < 0.7 * least_s(lambda frame: frame.left_px)


def test_sights_are_told_apart() -> None:
    assert gelstereo._native.sights() == {sight.name: sight.value for sight in Sight}
    assert gelstereo._native.sticks() == {stick.name: stick.value for stick in Stick}
    scene = Scene().replace(
        {
            "gel": {"missing": [[5, 5]], "centre_mm": [4.0, 1.3]},
            "effects": {
                "misprint": {"merged": [[3, 3, 3, 4]]},
                "smears": {"patches": [{"centre_px": [400, 240], "half_size_px": [30, 30]}]},
                "specks": {"count": 3},
            },
        }
    )
    dots = Simulator(scene)[0].left_dots
    assert set(dots.sight) == {Sight.WHOLE, Sight.CUT, Sight.MERGED, Sight.COVERED, Sight.NOT_PRINTED}
    assert dots.specks_px.shape == (3, 2)
    assert dots.half_px.shape == (625, 2, 2)


def test_presets_are_listed() -> None:
    assert Scene.preset(Scene.presets()[0]).to_dict() == Scene().to_dict()
    with pytest.raises(SceneError, match=r'no preset "8k".*640x480-25'):
        Scene.preset("8k")
