"""Stored pairs as camera images: seeded noise and JPEG compression are applied on reading."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

# About the level of the print where it is darkest.
BARE_LEVEL = 140
DATA = Path(__file__).parent / "data" / "images"


@dataclass(frozen=True)
class Condition:
    """Read noise and shot noise (grey levels; shot noise at level 255), and JPEG quality or None.

    `bare` replaces everything around the markers by a uniform grey, so that only the print remains.
    """

    read_levels: float = 1.0
    shot_levels: float = 2.0
    jpeg_quality: int | None = None
    bare: bool = False

    def applied(self, image: Bytes, seed: list[int]) -> Bytes:
        """The image with noise, rounded, and through JPEG."""
        rng = np.random.default_rng(seed)
        sigma = np.hypot(self.read_levels, self.shot_levels * np.sqrt(image / 255.0))
        noisy = np.clip(np.rint(image + sigma * rng.normal(size=image.shape)), 0, 255).astype(np.uint8)
        if self.jpeg_quality is None:
            return noisy
        coded = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


@dataclass(frozen=True)
class Sequence:
    """A rendered sequence: clean images and the truth of every frame.

    `truth` has points_mm (frames x 625 x 3, sensor frame), left_px, right_px, normals and touching; markers
    are in rows, from the first row's first.
    """

    name: str
    about: dict[str, Any]
    truth: dict[str, Array]

    @classmethod
    def load(cls, name: str) -> Sequence:
        """One sequence by its name."""
        with np.load(DATA / f"{name}.npz") as file:
            truth = {
                k: file[k] if file[k].dtype == bool else file[k].astype(float)
                for k in file.files
                if k != "about"
            }
            return cls(name, json.loads(str(file["about"])), truth)

    @property
    def half(self) -> str:
        """`w`: for development. `j`: held out, and not tuned on."""
        return str(self.about["half"])

    def __len__(self) -> int:
        return len(self.about["frames"])

    def clean(self, index: int, view: str) -> Bytes:
        """One rendered image."""
        path = DATA / f"{self.name}_{index:02d}_{view}.png"
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise FileNotFoundError(f"{path}: no image; `python -m outside.render {self.name}` makes it")
        return np.asarray(image, dtype=np.uint8)

    def pair(self, index: int, condition: Condition, seed: int = 1) -> tuple[Bytes, Bytes]:
        """Left and right image with noise and compression."""
        images = []
        for side, view in enumerate(("left", "right")):
            image = self.clean(index, view)
            if condition.bare:
                outline = cv2.convexHull(self.truth[f"{view}_px"][index].astype(np.float32))[:, 0]
                middle = outline.mean(axis=0)
                inside = np.zeros_like(image)
                cv2.fillConvexPoly(inside, np.rint(middle + 1.035 * (outline - middle)).astype(np.int32), 1)
                image = np.where(inside > 0, image, BARE_LEVEL).astype(np.uint8)
            images.append(condition.applied(image, [seed, index, side]))
        left, right = images
        return left, right


def names(half: str | None = None) -> list[str]:
    """Names of all stored sequences, or of one half."""
    found = sorted(path.stem for path in DATA.glob("*.npz"))
    return [name for name in found if half is None or Sequence.load(name).half == half]
