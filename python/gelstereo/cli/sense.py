"""The pipeline over a folder of stereo images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Frame, Params, Pipeline, Rig
from gelstereo.cli.files import as_grey, read_color_image, stereo_pairs
from gelstereo.progress import progress


@dataclass(frozen=True)
class Sensed:
    """The requested frame, with its left image, its name and the markers at rest."""

    name: str
    left: npt.NDArray[np.uint8]
    frame: Frame
    reference_px: npt.NDArray[np.float64]


def sense_folder(folder: Path, rig_file: Path | None, params: Params, frame: int = -1) -> Sensed:
    """Run the pipeline over ``left/*`` and ``right/*`` of a folder, up to a frame.

    The first pair is the rest frame. The rig is the folder's ``rig.toml`` unless another file is given.
    `frame` is a Python index and may be negative.
    """
    pairs = stereo_pairs(folder)
    if not -len(pairs) <= frame < len(pairs):
        raise Error(f"there is no frame {frame}; {folder} has {len(pairs)}, counted from 0")
    pairs = pairs[: (frame + len(pairs)) % len(pairs) + 1]
    pipeline = Pipeline(Rig.load(rig_file or folder / "rig.toml"), params)
    reference_px = None
    for left_path, right_path in progress(pairs, "sensing"):
        left = read_color_image(left_path)
        try:
            result = pipeline.process(left, read_color_image(right_path))
        except Error as error:
            raise type(error)(f"{left_path.name}: {error}") from error
        reference_px = result.left_px if reference_px is None else reference_px
    assert reference_px is not None  # there is at least one pair
    return Sensed(left_path.stem, as_grey(left), result, reference_px)
