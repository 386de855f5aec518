"""The camera plugin under LeRobot's own loader. Run by tests/test_lerobot.py in an environment that has
LeRobot.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import draccus
import lerobot_camera_gelstereo.camera_gelstereo as plugin
import numpy as np
import pytest
from lerobot.cameras import Camera, CameraConfig, make_cameras_from_configs
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_camera_gelstereo import GelStereoCamera, GelStereoCameraConfig
from lerobot_camera_gelstereo.pictures import displacement_picture

import gelstereo as gs
from gelstereo.live import LiveFrame

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "press_sphere.toml"
register_third_party_plugins()


def camera_of(**settings: object) -> Camera:
    """A camera as LeRobot makes it of the words of a command line."""
    words = {"type": "gelstereo", "source": "scene", "path": str(SCENE), **settings}
    config = draccus.decode(CameraConfig, words)
    return make_cameras_from_configs({"tactile": config})["tactile"]


def test_the_loader_finds_plugins_that_others_published() -> None:
    # Were the loader at fault, it would not find this one, either.
    config = draccus.decode(CameraConfig, {"type": "hex_dummy_camera", "width": 8, "height": 6})
    with make_cameras_from_configs({"dummy": config})["dummy"] as dummy:
        assert dummy.read().shape == (6, 8, 3)


def test_the_loader_finds_this_plugin() -> None:
    assert CameraConfig.get_choice_class("gelstereo") is GelStereoCameraConfig
    assert isinstance(camera_of(), GelStereoCamera)


@pytest.mark.parametrize(("picture", "width"), [("left", 640), ("pair", 1280), ("motion", 640)])
def test_pictures_come_at_their_size(picture: str, width: int) -> None:
    with camera_of(picture=picture, width=width, height=480, fps=30) as camera:
        for take in (camera.read, camera.async_read, camera.read_latest):
            image = take(10_000) if take == camera.async_read else take()
            assert image.shape == (480, width, 3) and image.dtype == np.uint8
    assert not camera.is_connected


def test_pictures_are_the_scenes_images() -> None:
    scene = gs.simulate(SCENE)
    known = {np.ascontiguousarray(scene[k].left).tobytes() for k in range(len(scene))}
    with camera_of() as camera:
        assert camera.fps == 30 and (camera.width, camera.height) == (640, 480)
        seen = [camera.async_read(10_000) for _ in range(3)]
    for image in seen:
        assert np.array_equal(image[:, :, 0], image[:, :, 1]) and np.array_equal(
            image[:, :, 0], image[:, :, 2]
        )
        assert np.ascontiguousarray(image[:, :, 0]).tobytes() in known
    # Each was a new one.
    assert not np.array_equal(seen[0], seen[1]) and not np.array_equal(seen[1], seen[2])


def test_motion_is_the_pipelines() -> None:
    scene = gs.simulate(SCENE)
    rest, pressed = (scene[k] for k in (0, len(scene) // 2))
    pipeline = gs.Pipeline(scene.scene.rig, gs.Params.preset("balanced"))
    points = [pipeline.process(f.left, f.right) for f in (rest, pressed)]
    moved_mm = points[1].points_mm - points[0].points_mm
    draw = plugin.MotionPicture(scene.scene.rig, gs.Params.preset("balanced"), 2.0)
    draw(LiveFrame(rest.left, rest.right, 0, 0))
    image = draw(LiveFrame(pressed.left, pressed.right, 1, 1))
    rows, cols = points[0].rows, points[0].cols
    y = (np.arange(rows) * 2 + 1) * 480 // (2 * rows)
    x = (np.arange(cols) * 2 + 1) * 640 // (2 * cols)
    read_mm = (image[y[:, None], x[None, :]].reshape(-1, 3).astype(float) - 128.0) / 127.0 * 2.0
    assert np.abs(read_mm - np.clip(moved_mm, -2.0, 2.0)).max() <= 0.5 * 2.0 / 127.0 + 1e-9
    assert np.abs(moved_mm).max() > 0.3


def test_displacements_beyond_the_scale_are_cut_off() -> None:
    image = displacement_picture(np.array([[9.0, -9.0, 0.0]]), (1, 1), 2.0, (3, 2))
    assert (image == [255, 1, 128]).all() and image.shape == (2, 3, 3)


@pytest.mark.parametrize(
    "settings",
    [
        {"source": "radio"},
        {"picture": "depth"},
        {"source": "camera"},
        {"source": "camera", "device": "/dev/video0", "picture": "motion"},
        {"path": None},
        {"motion_full_scale_mm": 0.0},
        {"fps": 0},
    ],
)
def test_a_configuration_that_makes_no_sense_says_what_would(settings: dict[str, object]) -> None:
    given = {"source": "scene", "path": SCENE, **settings}
    with pytest.raises(ValueError, match=r"; valid is "):
        GelStereoCameraConfig(**given)


@pytest.mark.parametrize("settings", [{"width": 320}, {"fps": 25}])
def test_a_size_or_rate_that_does_not_come_is_an_error(settings: dict[str, object]) -> None:
    camera = camera_of(**settings)
    with pytest.raises(ValueError, match=r"640 x 480|30 frames"):
        camera.connect()
    assert not camera.is_connected


def test_a_source_that_is_not_there_is_a_connection_error(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match=r"nowhere.*No such"):
        camera_of(path=str(tmp_path / "nowhere.toml")).connect()
    with pytest.raises(ConnectionError):
        camera_of(source="folder", path=str(tmp_path)).connect()


def test_only_a_connected_camera_is_read() -> None:
    camera = camera_of()
    for use in (camera.read, camera.async_read, camera.read_latest, camera.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            use()
    camera.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        camera.connect()
    camera.disconnect()
    camera.connect()
    assert camera.read().shape == (480, 640, 3)
    camera.disconnect()


def test_settings_of_a_camera_reach_it(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[tuple[str, dict[str, object]]] = []
    monkeypatch.setattr(plugin, "CameraSource", lambda device, **settings: opened.append((device, settings)))
    words = {"source": "camera", "path": None, "device": "serial:GS1", "fps": 60, "width": 640, "height": 480}
    for more in ({}, {"picture": "pair", "width": 1280}, {"right_device": "serial:GS2"}):
        plugin._source_of(camera_of(**{**words, **more}, settings={"exposure_us": 8000.0}).config)
    assert [settings["size_px"] for _, settings in opened] == [(1280, 480), (1280, 480), (640, 480)]
    assert all(device == "serial:GS1" and settings["exposure_us"] == 8000.0 for device, settings in opened)
    assert opened[0][1]["frame_rate_hz"] == 60 and opened[2][1]["right_device"] == "serial:GS2"


def test_cameras_that_are_found_have_an_id_to_open_them_by() -> None:
    for found in GelStereoCamera.find_cameras():
        assert found["type"] == "gelstereo" and found["id"]


class Silent:
    """A source whose camera is unplugged after three frames, or breaks."""

    name, rate_hz = "silent", None

    def __init__(self, frame: LiveFrame, error: Exception | None = None) -> None:
        self.frame, self.error, self.closed = frame, error, False

    def __iter__(self) -> Iterator[LiveFrame]:
        for sequence in range(3):
            yield dataclasses.replace(self.frame, sequence=sequence)
        if self.error is not None:
            raise self.error
        while not self.closed:
            time.sleep(0.02)
            yield dataclasses.replace(self.frame, stale=True, event="camera X is gone")

    def close(self) -> None:
        self.closed = True


def test_a_stale_frame_is_never_a_new_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.zeros((4, 6), dtype=np.uint8)
    monkeypatch.setattr(plugin, "_source_of", lambda config: Silent(LiveFrame(image, image, 0, 0)))
    with camera_of(max_stale_ms=100.0) as camera:
        time.sleep(0.2)
        camera.async_read()
        with pytest.raises(TimeoutError, match="camera X is gone"):
            camera.async_read(50)
        with pytest.raises(TimeoutError, match=r"ms old.*camera X is gone"):
            camera.read_latest()
        assert camera.read_latest(max_age_ms=60_000).shape == (4, 6, 3)


def test_a_source_that_broke_is_told_to_who_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.zeros((4, 6), dtype=np.uint8)
    broken = Silent(LiveFrame(image, image, 0, 0), OSError("bus error"))
    monkeypatch.setattr(plugin, "_source_of", lambda config: broken)
    camera = camera_of()
    camera.connect()
    time.sleep(0.2)
    with pytest.raises(DeviceNotConnectedError, match="bus error"):
        camera.read_latest()
    camera.disconnect()
