"""Images that a user takes of a sensor of their own: chessboards, the gel at rest and on boards, and a part
pressed in.

They are simulated. The cameras are those of `chessboards.TrueRig`; plate and gel bend the light in front of
them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from chessboards import TrueRig, write_pairs

import gelstereo as gs

LAYERS = {
    "normal": [0.0, 0.0, 1.0],
    "gap_mm": 20.0,
    "plates": [{"thickness_mm": 3.0, "index": 1.49}],
    "gel_index": 1.41,
}
GEL = {"rows": 19, "cols": 21, "pitch_mm": 0.8, "dot_radius_mm": 0.2, "surface_mm": 28.0}
PEG = {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 30.0}
#: Pairs in `rest/`.
REST_FRAMES = 12
#: The peg's pose when it is pressed deepest: its middle in the sensor frame, and its rotation vector.
PEG_MM, PEG_RAD = (4.0, 0.0, 30.6), (0.0, math.pi / 2, 0.0)


def true_rig() -> gs.Rig:
    """Cameras and layers as they are."""
    true = TrueRig.typical()
    cameras = gs.Rig.from_opencv(
        size_px=(640, 480),
        left_matrix=true.left_matrix,
        left_distortion=true.left_distortion,
        right_matrix=true.right_matrix,
        right_distortion=true.right_distortion,
        rotation=true.r_right_left,
        translation_mm=true.t_right_left_mm,
    )
    return cameras.with_layers(LAYERS)


def press(
    part: dict[str, Any], from_mm: float, to_mm: float, rotation_rad: tuple[float, ...]
) -> gs.Simulator:
    """A part that moves along z into the gel."""
    keyframes = [
        {"time_s": time_s, "position_mm": [4.0, 0.0, z_mm], "rotation_rad": list(rotation_rad)}
        for time_s, z_mm in ((0.0, from_mm), (0.3, to_mm))
    ]
    return gs.simulate(
        {
            "rig": gs._native.parse_toml(true_rig().to_toml()),
            "gel": GEL,
            "indenter": part,
            "effects": {"shoulder": {}, "spread": {}, "defocus": {}, "sensor_noise": {}},
            "trajectory": keyframes,
        }
    )


def write_own_sensor(folder: Path) -> None:
    """Write `chessboard/`, `gel/`, `rest/`, `press/` and `peg.stl`."""
    for name in ("chessboard", "gel", "rest/left", "rest/right", "press/left", "press/right"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    write_pairs(folder / "chessboard", TrueRig.typical(), 12)
    for height_mm in (0.8, 1.8):
        board = {"kind": "board", "size_mm": [30.0, 30.0], "block_mm": [8.0, 8.0], "protrusion_mm": height_mm}
        frames = press(board, 31.0, 28.0, (math.pi, 0.0, 0.0))
        write(frames[0], folder / "gel" / "rest_left.png", folder / "gel" / "rest_right.png")
        seated = frames[len(frames) - 1]
        write(seated, *(folder / "gel" / f"board_{height_mm}_{view}.png" for view in ("left", "right")))
    presses = press(PEG, 33.0, PEG_MM[2], PEG_RAD)
    for n in range(REST_FRAMES):
        at_rest = presses.press(frame=n)
        write(at_rest, *(folder / "rest" / view / f"{n:04}.png" for view in ("left", "right")))
    for frame in presses:
        write(frame, *(folder / "press" / view / f"{frame.index:04}.png" for view in ("left", "right")))
    peg = trimesh.creation.cylinder(PEG["radius_mm"], PEG["length_mm"], sections=256)
    peg.export(folder / "peg.stl")


def write(frame: gs.SimulatedFrame, left: Path, right: Path) -> None:
    """Write both images of a frame."""
    for path, image in ((left, frame.left), (right, frame.right)):
        cv2.imwrite(str(path), np.asarray(image))
