"""A GelStereo sensor as LeRobot's `Camera`: a thread reads the sensor, and reading gives the
newest picture.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from lerobot.cameras import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import gelstereo as gs
from gelstereo.live import CameraSource, FolderSource, LiveFrame, LiveSource, SceneSource
from gelstereo.live.latest import Latest

from .config_gelstereo import GelStereoCameraConfig
from .pictures import MotionPicture, Picture, left_picture, pair_picture

logger = logging.getLogger(__name__)

_DEFAULT_TIMEOUT_MS = 200.0  # of LeRobot's own cameras
_STOP_TIMEOUT_S = 5.0


class GelStereoCamera(Camera):
    """A GelStereo sensor, a simulated one, or a folder of its images, as LeRobot sees cameras.

    Pictures are (height, width, 3) uint8, red green blue. Frames that the source marks as stale are never
    handed out as new ones; reading raises ``TimeoutError`` instead, with the source's last event.
    """

    def __init__(self, config: GelStereoCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._source: LiveSource | None = None
        self._thread: threading.Thread | None = None
        self._newest: Latest[tuple[Picture, float]] = Latest()
        self._consumed = 0
        self._event: str | None = None
        self._failure: Exception | None = None

    def __str__(self) -> str:
        place = self.config.device if self.config.source == "camera" else self.config.path
        return f"GelStereoCamera({self.config.source} {place}, {self.config.picture})"

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is being read."""
        return self._thread is not None and self._thread.is_alive()

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Cameras of this computer that may be sensors: what `gelstereo.cameras.list` finds."""
        from gelstereo import cameras

        found = [camera for camera in cameras.list() if camera.kind == "capture"]
        return [
            {
                "name": camera.name,
                "type": "gelstereo",
                "id": camera.path if camera.serial is None else f"serial:{camera.serial}",
                "path": camera.path,
            }
            for camera in found
        ]

    def connect(self, warmup: bool = True) -> None:
        """Open the sensor and wait for its first picture.

        Parameters
        ----------
        warmup
            Without it, the first picture is not waited for, nor is its size checked.

        Raises
        ------
        DeviceAlreadyConnectedError
        ConnectionError
            If the sensor cannot be opened or gives no picture in time.
        ValueError
            If the picture's size or rate is not the configured one.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._newest, self._consumed, self._event, self._failure = Latest(), 0, None, None
        try:
            self._source = _source_of(self.config)
            self._check_rate(self._source.rate_hz)
            draw = _picture_of(self.config, self._source)
        except (gs.Error, OSError) as error:
            raise ConnectionError(f"{self} cannot be opened: {error}") from error
        self._thread = threading.Thread(
            target=self._work, args=(self._source, draw), name=str(self), daemon=True
        )
        self._thread.start()
        if warmup:
            self._warm_up()
        logger.info("%s connected.", self)

    def _check_rate(self, rate_hz: float | None) -> None:
        if self.fps is None:
            self.fps = None if rate_hz is None else round(rate_hz)
        elif rate_hz is not None and abs(self.fps - rate_hz) > 1e-3 * rate_hz:
            raise ValueError(f"fps is {self.fps}; {self} gives {rate_hz:g} frames a second")

    def _warm_up(self) -> None:
        found = self._newest.newer_than(0, self.config.connect_timeout_s)
        if found is None:
            reason = self._failure or self._event or "no frame came"
            self._stop()
            raise ConnectionError(
                f"{self} gave no picture within {self.config.connect_timeout_s:g} s: {reason}"
            ) from self._failure
        height, width = found[1][0].shape[:2]
        asked = (self.width or width, self.height or height)
        if asked != (width, height):
            self._stop()
            raise ValueError(
                f"width and height are {asked[0]} x {asked[1]}; {self} gives {width} x {height} pixels"
            )
        self.width, self.height = width, height

    def disconnect(self) -> None:
        """Release the sensor."""
        if self._thread is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._stop()
        logger.info("%s disconnected.", self)

    def _stop(self) -> None:
        if self._source is not None:
            self._source.close()
        if self._thread is not None:
            self._thread.join(_STOP_TIMEOUT_S)
        self._source = self._thread = None

    def read(self) -> Picture:
        """The next picture, which is newer than this call; `config.connect_timeout_s` is how long it is
        waited for.

        Raises
        ------
        DeviceNotConnectedError, TimeoutError
        """
        self._require_connected()
        self._consumed = self._newest.number
        return self.async_read(1e3 * self.config.connect_timeout_s)

    def async_read(self, timeout_ms: float = _DEFAULT_TIMEOUT_MS) -> Picture:
        """The newest picture that was not read yet.

        Raises
        ------
        DeviceNotConnectedError
        TimeoutError
            If no new one comes within `timeout_ms`.
        """
        self._require_connected()
        found = self._newest.newer_than(self._consumed, timeout_ms * 1e-3)
        if found is None:
            self._require_connected()
            raise TimeoutError(f"{self} gave no new picture within {timeout_ms:g} ms{self._told()}")
        self._consumed = found[0]
        return found[1][0]

    def read_latest(self, max_age_ms: float | None = None) -> Picture:
        """The newest picture at once, whether it was read before or not.

        Parameters
        ----------
        max_age_ms
            Oldest picture that is good enough; `config.max_stale_ms` if left out.

        Raises
        ------
        DeviceNotConnectedError
        TimeoutError
            If the newest picture is older.
        RuntimeError
            If there is none yet.
        """
        self._require_connected()
        max_age_ms = self.config.max_stale_ms if max_age_ms is None else max_age_ms
        found = self._newest.newer_than(0, 0.0)
        if found is None:
            raise RuntimeError(f"{self} has not given a picture yet{self._told()}")
        picture, taken_s = found[1]
        age_ms = 1e3 * (time.monotonic() - taken_s)
        if age_ms > max_age_ms:
            raise TimeoutError(
                f"the newest picture of {self} is {age_ms:.0f} ms old; valid is up to "
                f"{max_age_ms:g}{self._told()}"
            )
        return picture

    def _told(self) -> str:
        return "" if self._event is None else f"; {self._event}"

    def _require_connected(self) -> None:
        if self.is_connected:
            return
        why = "" if self._failure is None else f" It stopped: {self._failure}"
        raise DeviceNotConnectedError(f"{self} is not connected.{why}") from self._failure

    def _work(self, source: LiveSource, draw: Callable[[LiveFrame], Picture]) -> None:
        try:
            for frame in source:
                self._take(frame, draw)
        except Exception as error:  # told by whoever reads next
            self._failure = error
        finally:
            self._newest.close()

    def _take(self, frame: LiveFrame, draw: Callable[[LiveFrame], Picture]) -> None:
        if frame.event is not None:
            self._event = frame.event
            logger.warning("%s: %s", self, frame.event)
        if frame.stale:
            return
        try:
            picture = draw(frame)
        except gs.Error as error:
            # A frame without markers is like one that did not come; many of them make the picture stale.
            self._event = str(error)
            return
        self._event = None
        self._newest.put((picture, time.monotonic()))


def _source_of(config: GelStereoCameraConfig) -> LiveSource:
    if config.source == "scene":
        return SceneSource(str(config.path))
    if config.source == "folder":
        assert config.path is not None  # checked by the configuration
        return FolderSource(config.path, **({} if config.fps is None else {"rate_hz": float(config.fps)}))
    return _camera_of(config)


def _camera_of(config: GelStereoCameraConfig) -> CameraSource:
    assert config.device is not None  # checked by the configuration
    settings: dict[str, Any] = {
        "right_device": config.right_device,
        "frame_rate_hz": config.fps,
        **config.settings,
    }
    if config.picture != "motion" and config.width is not None and config.height is not None:
        # The picture shows one view or both; a stereo device's frames have both side by side.
        beside = config.right_device is None and not str(settings.get("layout", "")).startswith("interleaved")
        view_width = config.width // 2 if config.picture == "pair" else config.width
        settings.setdefault("size_px", (2 * view_width if beside else view_width, config.height))
    return CameraSource(config.device, **settings)


def _picture_of(config: GelStereoCameraConfig, source: LiveSource) -> Callable[[LiveFrame], Picture]:
    if config.picture == "left":
        return left_picture
    if config.picture == "pair":
        return pair_picture
    if isinstance(source, SceneSource) and config.rig is None:
        rig = source.rig
    elif config.rig is None and config.path is not None:
        rig = gs.Rig.load(config.path / "rig.toml")
    else:
        rig = gs.Rig.load(str(config.rig))
    size = (config.width or rig.size_px[0], config.height or rig.size_px[1])
    return MotionPicture(rig, gs.Params.preset(config.preset), config.motion_full_scale_mm, size)
