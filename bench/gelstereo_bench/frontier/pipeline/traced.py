"""Path-traced scenes of the front: the half of ``bench/outside`` that is for work. The seed draws the
images' noise.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Error, Rig
from gelstereo_bench.frontier.pipeline.cases import Body, Case, Shot, Take
from gelstereo_bench.frontier.pipeline.evaluation import outside

__all__ = ["traced_cases"]

Array = npt.NDArray[np.float64]

#: Levels below the box background and least area for OpenCV, set by hand for these images.
_BY_HAND = {"detect": {"threshold_levels": 12, "min_area_px2": 12}}
#: Points on an edge that is rounded: chords are then within 1 um of an arc of 0.4 mm.
_ARC = 24


def traced_cases() -> list[Case]:
    """All path-traced sequences of half `w`.

    Each is played forth, back and forth.

    Raises
    ------
    Error
        The folder ``bench`` is not on Python's path.
    """
    names = outside("images").names("w")
    return [Case(_title(name), "path-traced", partial(_take, name)) for name in names]


def _title(name: str) -> str:
    return name.split("_", 1)[1].replace("_", " ")


@cache
def _clean(name: str) -> list[Shot]:
    """Shots of a sequence without noise."""
    from outside.images import Sequence
    from outside.judge import under_glints

    sequence = Sequence.load(name)
    shots = []
    for index, frame in enumerate(sequence.about["frames"]):
        true = {key: values[index] for key, values in sequence.truth.items()}
        body, pose = (None, None) if frame == "rest" else _pressed(frame, sequence.truth["points_mm"][0])
        shots.append(
            Shot(
                sequence.clean(index, "left"),
                sequence.clean(index, "right"),
                true["left_px"],
                true["right_px"],
                true["points_mm"],
                ~under_glints(sequence, index),
                true["touching"].astype(bool),
                body,
                pose,
            )
        )
    return shots


def _take(name: str, seed: int) -> Take:
    from outside.images import Condition, Sequence

    sequence, clean = Sequence.load(name), _clean(name)
    last = len(clean) - 1
    # Forth, back and forth, each time with other noise, so that there are frames enough to time.
    way = [*range(last), *range(last, 0, -1), *range(last + 1)]
    shots = []
    for place, index in enumerate(way):
        left, right = sequence.pair(index, Condition(), 1000 * seed + place)
        shots.append(replace(clean[index], left=left, right=right))
    judged = [place for place in range(last + 1) if shots[place].patch is not None]
    rig = Rig.from_toml(sequence.about["rig"])
    return Take(rig, sequence.about["pitch_mm"], shots, judged, _BY_HAND, is_layered=True)


def _pressed(frame: tuple[str, int, float, float], rest_mm: Array) -> tuple[Body, Array]:
    """The part of a frame, and its pose in the sensor frame.

    Parameters
    ----------
    frame
        Contact, stage, and the place of first touch from the print's middle, mm.
    rest_mm
        (N, 3) markers at rest, sensor frame.
    """
    from outside.optics import Optics, turned
    from outside.prints import MIDDLE_MM

    name, stage, x_mm, y_mm = frame
    body, own, height_mm, stages = _at_touch(name)
    depth_mm, along_x_mm, along_y_mm, twist_deg = stages[stage]
    # From the world to the sensor, the left camera's frame; both have their origin in that camera.
    rotation = Optics(1.0).left.rotation.T
    surface_mm = float(np.mean((rest_mm @ rotation)[:, 2]))
    world = np.eye(4)
    world[:3, :3] = turned(0.0, 0.0, twist_deg) @ own
    world[:2, 3] = MIDDLE_MM + [x_mm + along_x_mm, y_mm + along_y_mm]
    world[2, 3] = surface_mm + height_mm - depth_mm
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return body, pose @ world


@cache
def _at_touch(name: str) -> tuple[Body, Array, float, list[list[float]]]:
    """Of a stored contact: the part, its rotation and its origin's height over the gel at first touch, and
    the stages.
    """
    from outside.fields import Field
    from outside.optics import turned
    from outside.parts import Part

    meta = Field.load(name).meta
    part, rotation = Part.read(meta["part"]), turned(*Part.read(meta["part"]).turn_deg)
    return Body(name, _mesh(part)), rotation, _reach_mm(part, rotation[2]), meta["stages"]


def _reach_mm(part: Any, along: Array) -> float:
    """How far a part reaches from its origin in a direction of its own frame."""
    inner = np.array(part.half_mm) - part.edge_mm
    if part.kind == "ball":
        return float(part.half_mm[0])
    if part.kind == "cylinder":
        return float(abs(along[0]) * inner[0] + np.hypot(along[1], along[2]) * inner[1] + part.edge_mm)
    return float(np.abs(along) @ inner + part.edge_mm)


def _mesh(part: Any) -> trimesh.Trimesh:
    """Triangles of a ball, or of a box or cylinder with rounded edges.

    Raises
    ------
    Error
        The part is of another kind.
    """
    if part.kind == "ball":
        return trimesh.creation.icosphere(5, part.half_mm[0])
    inner = np.array(part.half_mm) - part.edge_mm
    if part.kind == "box":
        round_edge = trimesh.creation.icosphere(3, part.edge_mm).vertices
        corners = np.array(list(product((-1.0, 1.0), repeat=3))) * inner
        points = (corners[:, None] + round_edge[None]).reshape(-1, 3)
    elif part.kind == "cylinder":
        arc = np.linspace(0.0, 0.5 * np.pi, _ARC)
        turn = np.linspace(0.0, 2.0 * np.pi, 8 * _ARC, endpoint=False)
        radius = (inner[1] + part.edge_mm * np.cos(arc))[:, None]
        along = np.repeat((inner[0] + part.edge_mm * np.sin(arc))[:, None], len(turn), axis=1)
        rim = np.stack([along, radius * np.cos(turn), radius * np.sin(turn)], axis=-1).reshape(-1, 3)
        points = np.vstack([rim, rim * [-1.0, 1.0, 1.0]])
    else:
        raise Error(f"a path-traced part is a {part.kind}; valid are ball, box and cylinder")
    return trimesh.convex.convex_hull(points)
