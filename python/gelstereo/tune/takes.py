"""Stereo frames to tune on: simulated with ground truth, or of the user's own recording."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Rig, Scene, Simulator
from gelstereo.cli.files import read_image, stereo_pairs
from gelstereo.setup.sensor import Sensor
from gelstereo.tune.goal import TuneError

__all__ = ["WARM_UP", "Shot", "Take", "Takes", "recorded_takes", "simulated_takes"]

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

#: Frames before the timed ones: rest, and the first that is found from it.
WARM_UP = 2
#: A median of times needs some frames: four that are timed.
MIN_FRAMES = WARM_UP + 4
#: Frames of a take of a recording: two seconds at 30 Hz. Twelve such takes of 640x480 fill 0.5 GB.
_MAX_FRAMES = 60


@dataclass(frozen=True)
class Shot:
    """A stereo frame, and its truth if it is simulated.

    Attributes
    ----------
    left, right : (H, W) uint8
    points_mm : (N, 3) float64 or None
        True markers, sensor frame.
    t_sensor_object : (4, 4) float64 or None
        True pose of the part.
    """

    left: Image
    right: Image
    points_mm: Floats | None = None
    t_sensor_object: Floats | None = None


class Take:
    """Frames in their order, read or simulated on first use; nothing touches the gel in the first one."""

    def __init__(self, load: Callable[[], Sequence[Shot]]) -> None:
        self._load = load

    @cached_property
    def shots(self) -> Sequence[Shot]:
        """All frames."""
        return self._load()


@dataclass(frozen=True)
class Takes:
    """All frames of one sensor: those to tune on, and those to check the result with.

    Attributes
    ----------
    rig : Rig
    lattice : (int, int)
        Rows and columns of the print.
    tuning, held_out : tuple of Take
    is_simulated : bool
        Whether the frames have their truth.
    digest : str
        SHA-256 of what the frames are made of: the scene or the recording.
    """

    rig: Rig
    lattice: tuple[int, int]
    tuning: tuple[Take, ...] = field(repr=False)
    held_out: tuple[Take, ...] = field(repr=False)
    is_simulated: bool
    digest: str

    @classmethod
    def split(
        cls, rig: Rig, lattice: tuple[int, int], takes: Sequence[Take], is_simulated: bool, digest: str
    ) -> Takes:
        """Every third take is held out, so that both kinds are from all times."""
        tuning = tuple(take for number, take in enumerate(takes) if number % 3 != 1)
        return cls(rig, lattice, tuning, tuple(takes[1::3]), is_simulated, digest)


def simulated_takes(scene: Scene, count: int, *, sensor: Sensor | None = None) -> Takes:
    """Simulate a scene several times, each time with another seed of its noise and print.

    Parameters
    ----------
    scene
        Its first frame must be untouched.
    count
        Number of takes, 2 or more. Every third is held out.
    sensor
        If given, its cameras, print and image noise replace the scene's. The part keeps its place over the
        gel.

    Raises
    ------
    TuneError
        The scene has too few frames, or does not have images.
    SceneError
        The sensor cannot be simulated with this scene.
    """
    if sensor is not None:
        scene = _on_sensor(scene, sensor)
    asked = scene.to_dict().get("asked")
    if asked is not None and asked["kind"] != "images":
        raise TuneError(f"the scene asks for {asked['kind']}; tuning needs one that has images")
    seed = scene.to_dict()["seed"]
    simulators = [Simulator(scene.replace({"seed": seed + number})) for number in range(count)]
    _enough(len(simulators[0]), "the scene", MIN_FRAMES)
    takes = [Take(partial(_simulated, simulator)) for simulator in simulators]
    gel = scene.to_dict()["gel"]
    return Takes.split(scene.rig, (gel["rows"], gel["cols"]), takes, True, _digest(scene, simulators[0]))


def _simulated(simulator: Simulator) -> list[Shot]:
    return [
        Shot(frame.left, frame.right, np.array(frame.points_mm), frame.t_sensor_object) for frame in simulator
    ]


def _on_sensor(scene: Scene, sensor: Sensor) -> Scene:
    """The scene with another sensor under it."""
    old, new = scene.to_dict(), sensor.scene().to_dict()
    shift_mm = np.append(new["gel"]["centre_mm"], new["gel"]["surface_mm"])
    shift_mm -= np.append(old["gel"]["centre_mm"], old["gel"]["surface_mm"])

    def moved(trajectory: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [{**key, "position_mm": list(np.add(key["position_mm"], shift_mm))} for key in trajectory]

    others = [{**other, "trajectory": moved(other["trajectory"])} for other in old["others"]]
    printed = ("rows", "cols", "layout", "odd_rows_forward", "pitch_mm", "dot_radius_mm", "bright_dots")
    gel = {name: new["gel"][name] for name in (*printed, "surface_mm", "centre_mm")}
    effects = {**old["effects"], "sensor_noise": new["effects"]["sensor_noise"]}
    return scene.replace(
        {
            "rig": new["rig"],
            "trajectory": moved(old["trajectory"]),
            "others": others,
            "gel": gel,
            "effects": effects,
        }
    )


def _digest(scene: Scene, simulator: Simulator) -> str:
    """Of the scene, and of its last frame's markers, which a changed mesh file moves."""
    markers = simulator[len(simulator) - 1].points_mm
    return hashlib.sha256(scene.to_toml().encode() + markers.tobytes()).hexdigest()


def recorded_takes(path: Path, sensor: Sensor, count: int) -> Takes:
    """Cut a recording into takes: its first frame at rest, followed by consecutive frames.

    Every third take is held out. Of a long recording, each take has the first 60 frames of its share.

    Parameters
    ----------
    path
        MCAP file with images, or a folder with ``left/NAME.png`` and ``right/NAME.png``. Nothing touches the
        gel in its first frame.
    sensor
        The sensor that was recorded.
    count
        Largest number of takes, 2 or more; fewer if the recording is short.

    Raises
    ------
    TuneError
        It has no images, images of another size than the rig's, or too few frames.
    """
    source = _Folder(path) if path.is_dir() else _File(path)
    _enough(source.count, str(path), 2 * MIN_FRAMES)
    # The first frame is that of rest, which all takes share.
    count = min(count, (source.count - 1) // (MIN_FRAMES - 1))
    starts = [1 + number * (source.count - 1) // count for number in range(count + 1)]
    spans = [range(a, min(b, a + _MAX_FRAMES)) for a, b in pairwise(starts)]

    @cache
    def shots() -> dict[int, Shot]:
        found = source.shots({0}.union(*spans))
        _check_size(path, found[0], sensor.rig)
        return found

    def load(span: range) -> list[Shot]:
        return [shots()[index] for index in (0, *span)]

    takes = [Take(partial(load, span)) for span in spans]
    lattice = (int(sensor.gel["rows"]), int(sensor.gel["cols"]))
    return Takes.split(sensor.rig, lattice, takes, False, source.digest())


def _check_size(path: Path, shot: Shot, rig: Rig) -> None:
    (height, width), size_px = shot.left.shape, rig.size_px
    if (width, height) != size_px:
        raise TuneError(
            f"{path} has images of {width}x{height} pixels and the sensor of {size_px[0]}x{size_px[1]}; "
            "record with the sensor of the sensor file"
        )


def _enough(count: int, what: str, least: int) -> None:
    if count < least:
        raise TuneError(f"{what} has {count} frames; tuning needs {least} or more")


def _digest_of_files(paths: Sequence[Path]) -> str:
    found = hashlib.sha256()
    for path in paths:
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


class _Folder:
    """Stereo images in a folder."""

    def __init__(self, folder: Path) -> None:
        self._pairs = stereo_pairs(folder)
        self.count = len(self._pairs)

    def digest(self) -> str:
        return _digest_of_files([path for pair in self._pairs for path in pair])

    def shots(self, wanted: Collection[int]) -> dict[int, Shot]:
        names = {index: self._pairs[index] for index in sorted(wanted)}
        return {index: Shot(read_image(left), read_image(right)) for index, (left, right) in names.items()}


class _File:
    """A recording with images."""

    def __init__(self, path: Path) -> None:
        # Folders of images need no reader of recordings.
        from gelstereo.export.recording import frame_times_ns, recorded_frames

        self._path, self._frames = path, recorded_frames
        self.count = len(frame_times_ns(path))

    def digest(self) -> str:
        return _digest_of_files([self._path])

    def shots(self, wanted: Collection[int]) -> dict[int, Shot]:
        shots = {}
        for index, frame in enumerate(self._frames(self._path)):
            if index in wanted and len(frame.images) == 2:
                shots[index] = Shot(frame.images["left"], frame.images["right"])
        missing = sorted(set(wanted) - set(shots))
        if missing:
            raise TuneError(
                f"{self._path} has no images for {len(missing)} of {len(wanted)} frames; record all images, "
                "or give a folder of stereo images"
            )
        return shots
