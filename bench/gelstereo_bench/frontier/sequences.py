"""Difficult sequences for marker identities, with known truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import SimulatedFrame, Simulator
from gelstereo_bench.frontier.scenes import SURFACE_MM, VGA

__all__ = ["SEQUENCES", "Run", "Shot", "Task"]

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

_PITCH_MM = 0.9


@dataclass(frozen=True)
class Shot:
    """One stereo frame, the positions of its markers, and a mask of those visible in both images."""

    left: Image
    right: Image
    left_px: Array
    right_px: Array
    visible: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, frame: SimulatedFrame, visible: npt.NDArray[np.bool_] | None = None) -> Shot:
        """Create a shot in which all markers within both images are visible, or a subset."""
        height, width = frame.left.shape
        inside = np.ones(len(frame.left_px), bool)
        for pixels in (frame.left_px, frame.right_px):
            inside &= ((pixels >= 0.0) & (pixels <= (width - 1, height - 1))).all(axis=1)
        if visible is not None:
            inside &= visible
        return cls(frame.left, frame.right, frame.left_px, frame.right_px, inside)

    def changed(self, change: Callable[[Image, Array], Image]) -> Shot:
        """Modify both images, with a function of the image and its marker positions."""
        return Shot(
            change(self.left, self.left_px),
            change(self.right, self.right_px),
            self.left_px,
            self.right_px,
            self.visible,
        )


@dataclass(frozen=True)
class Run:
    """Frames in order; those from ``calm`` on are undisturbed."""

    shots: Sequence[Shot]
    calm: int


@dataclass(frozen=True)
class Task:
    """Sequences of one kind of difficulty, created lazily."""

    name: str
    make: Callable[[], Sequence[Run]]
    #: Settings that the user must know.
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def _simulator(gel: Mapping[str, Any] | None = None, **effects: Mapping[str, float]) -> Simulator:
    scene = VGA.scene(gel=gel).replace({"indenter": {"kind": "sphere", "radius_mm": 6.0}})
    return Simulator(scene.replace({"effects": {name: dict(values) for name, values in effects.items()}}))


def _pose(simulator: Simulator, depth_mm: float) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = (*VGA.centre_mm, SURFACE_MM)
    return simulator.pressed(pose, depth_mm)


def _there_and_back(steps: int, still: int = 3) -> Array:
    """Fractions from 0 to 1 and back to 0, followed by some frames at rest."""
    up = np.linspace(0.0, 1.0, steps)
    return np.concatenate([up, up[-2::-1], np.zeros(still)])


def _press() -> list[Run]:
    simulator = _simulator()
    shots = [
        Shot.of(simulator.press(_pose(simulator, 2.0 * share) if share > 0.0 else None, frame=index))
        for index, share in enumerate(_there_and_back(9))
    ]
    return [Run(shots, len(shots) - 3)]


def _shear(pitches: float = 2.0, twist_deg: float = 0.0, every: int = 1) -> list[Run]:
    """Press 1 mm deep, then shear or twist the surface with the part, and back; optionally only every nth
    frame.
    """
    simulator = _simulator(drag={})
    shots = [Shot.of(simulator.press(None, frame=0))]
    shots += [Shot.of(simulator.press(_pose(simulator, depth_mm), frame=1)) for depth_mm in (0.35, 0.7)]
    moving = _there_and_back(11, still=0)[::every]
    for index, share in enumerate(np.concatenate([moving, np.zeros(3)])):
        pose = _pose(simulator, 1.0).copy()
        shear_mm = float(share) * pitches * _PITCH_MM
        pose[0, 3] += shear_mm
        turn = float(np.deg2rad(share * twist_deg))
        frame = simulator.press(pose, shear_mm=(shear_mm, 0.0), twist_rad=turn, frame=3 + index)
        shots.append(Shot.of(frame))
    return [Run(shots, len(shots) - 3)]


def _twist() -> list[Run]:
    return _shear(0.0, 30.0)


def _dropped() -> list[Run]:
    """Shear by 2 pitches with two of three frames lost: neighbours move by 0.6 pitches at once."""
    return _shear(every=3)


def _rotations() -> list[Run]:
    """Rotate the lattice in its plane by all multiples of 15 degrees; every sequence has its own
    first frame.
    """
    sequences = []
    for degrees in range(0, 360, 15):
        # A smaller lattice, because the corners of the usual one would leave the image.
        gel = {"rotation_rad": float(np.deg2rad(degrees)), "pitch_mm": 0.62, "dot_radius_mm": 0.16}
        simulator = _simulator(gel)
        depths_mm = (None, 0.5, 1.0, 1.5)
        shots = [
            Shot.of(simulator.press(None if d is None else _pose(simulator, d), frame=index))
            for index, d in enumerate(depths_mm)
        ]
        sequences.append(Run(shots, len(shots) - 1))
    return sequences


def _contact_first() -> list[Run]:
    """Start under contact at several depths, without a rest frame."""
    simulator = _simulator()
    sequences = []
    for depth_mm in (0.5, 1.0, 1.5, 2.0):
        frame = simulator.press(_pose(simulator, depth_mm), frame=0)
        sequences.append(Run([Shot.of(frame)] * 3, 2))
    return sequences


def _moved(offsets_mm: Sequence[tuple[float, float]]) -> list[Shot]:
    """Move the whole lattice; every frame has its own noise."""
    x, y = VGA.centre_mm
    shots = []
    for index, (right_mm, down_mm) in enumerate(offsets_mm):
        simulator = Simulator(VGA.scene(gel={"centre_mm": [x + right_mm, y + down_mm]}))
        shots.append(Shot.of(simulator.press(None, frame=index)))
    return shots


def _jumps() -> list[Run]:
    """Jump by 1.3 pitches between frames: along a row, along a column, and across."""
    half = 0.65 * _PITCH_MM
    diagonal = half / np.sqrt(2.0)
    ways = ((half, 0.0), (0.0, half), (diagonal, diagonal))
    return [
        Run(_moved([(0.0, 0.0)] + [(side * dx, side * dy) for side in (1, -1) * 3] + [(-dx, -dy)] * 3), 7)
        for dx, dy in ways
    ]


def _border() -> list[Run]:
    """Move down until two rows have left the image, and back."""
    offsets = np.concatenate([np.linspace(0.0, 3.0, 9), np.linspace(3.0, 0.0, 9), np.zeros(3)])
    return [Run(_moved([(0.0, float(down)) for down in offsets]), 18)]


def _smears() -> list[Run]:
    """Move smears over the markers while a part presses."""
    simulator = _simulator()
    random = np.random.default_rng(20211)
    starts = random.uniform((200, 40), (600, 440), (6, 2))
    ways = random.normal(0.0, 60.0, (6, 2))
    shots = []
    for index, share in enumerate(_there_and_back(9)):
        shot = Shot.of(simulator.press(_pose(simulator, 1.5 * share) if share > 0.0 else None, frame=index))
        if 2 <= index < 16:
            shot = shot.changed(partial(_smeared, starts=starts + 6.0 * index, ways=ways))
        shots.append(shot)
    return [Run(shots, 16)]


def _smeared(image: Image, _: Array, *, starts: Array, ways: Array) -> Image:
    """Draw dark streaks with blurred edges over the image."""
    streaks = np.zeros(image.shape, np.float32)
    for start, way in zip(starts, ways, strict=True):
        ends = [tuple(int(v) for v in np.rint(p)) for p in (start, start + way)]
        cv2.line(streaks, ends[0], ends[1], 1.0, 9)
    streaks = cv2.GaussianBlur(streaks, (0, 0), 2.0)
    return np.asarray(np.rint(image * (1.0 - 0.6 * streaks)), np.uint8)


def _missing() -> list[Run]:
    """Omit 20 % of the dots, but none at the border, so that rows and columns can be counted."""
    random = np.random.default_rng(20212)
    inner = [(row, col) for row in range(1, 24) for col in range(1, 24)]
    chosen = [inner[i] for i in random.choice(len(inner), 125, replace=False)]
    visible = np.ones((25, 25), bool)
    visible[tuple(np.transpose(chosen))] = False
    simulator = _simulator({"missing": [list(map(int, place)) for place in chosen]})
    shots = []
    for index, share in enumerate(_there_and_back(9)):
        frame = simulator.press(_pose(simulator, 1.5 * share) if share > 0.0 else None, frame=index)
        shots.append(Shot.of(frame, visible.ravel()))
    return [Run(shots, len(shots) - 3)]


def _merged() -> list[Run]:
    """Join pairs of neighbours by a bar of their colour in some frames of a press."""
    simulator = _simulator()
    random = np.random.default_rng(20213)
    pairs = [(25 * row + col, 25 * row + col + 1) for row, col in random.integers(1, 23, (12, 2))]
    shots = []
    for index, share in enumerate(_there_and_back(9)):
        shot = Shot.of(simulator.press(_pose(simulator, 1.5 * share) if share > 0.0 else None, frame=index))
        if 2 <= index < 16:
            shot = shot.changed(partial(_joined, pairs=pairs))
        shots.append(shot)
    return [Run(shots, 16)]


def _joined(image: Image, pixels: Array, *, pairs: Sequence[tuple[int, int]]) -> Image:
    joined = image.copy()
    for a, b in pairs:
        ends = [tuple(int(v) for v in np.rint(pixels[i])) for i in (a, b)]
        cv2.line(joined, ends[0], ends[1], 55, 5)
    return np.asarray(joined, np.uint8)


_ROOM = {"lattice": {"max_missing_share": 0.25}}

SEQUENCES = (
    Task("press to 2 mm", _press),
    Task("shear to 2 pitches", _shear),
    Task("twist to 30 deg", _twist),
    Task("lattice turned by 0 to 345 deg", _rotations),
    Task("first frame under contact", _contact_first),
    Task("jumps of 1.3 pitches", _jumps),
    Task("two of three frames dropped", _dropped),
    Task("smears", _smears),
    Task("20 % not printed", _missing, _ROOM),
    Task("merged pairs", _merged),
    Task("two border rows leave the view", _border),
)
