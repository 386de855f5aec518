"""Seven simulated scenes of the front. The seed draws the part's pose and the noise."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
import trimesh

from gelstereo import Error, Scene, Simulator, parts
from gelstereo.geometry import se3_log
from gelstereo_bench.frontier.centres import CONDITIONS
from gelstereo_bench.frontier.grasps import Press, place
from gelstereo_bench.frontier.pipeline.cases import MIN_TOUCHING, Body, Case, Shot, Take
from gelstereo_bench.frontier.scenes import VGA, effects, layered_scene

__all__ = ["SIMULATED", "Contact", "simulated_cases"]

_PRESS_S, _SHEAR_S = 0.3, 0.2
#: Distance of the part from the gel in the first frame, mm.
_CLEARANCE_MM = 0.2
#: The paper's threshold of saliency, and the share of a shallow press that replaces it, for OpenCV.
_SALIENT_MM, _SALIENT_SHARE = 0.35, 0.5
#: OpenCV's threshold as a share of the contrast between print and dot: 20 of 120 levels, set by hand.
_THRESHOLD_SHARE = 1.0 / 6.0


@dataclass(frozen=True)
class Contact:
    """A part and how it is pressed."""

    name: str
    press: Press
    depth_mm: float
    #: The scene without a part.
    scene: Callable[[], Scene]
    #: Motion along x in contact, which drags the gel, mm.
    shear_mm: float = 0.0


def _plain() -> Scene:
    return VGA.scene()


def _dragged() -> Scene:
    return VGA.scene().replace({"effects": effects(drag={})})


def _dim() -> Scene:
    return next(each for each in CONDITIONS if each.name == "35 % of the light").scene(1)


def _dense() -> Scene:
    return VGA.scene(45)


def _rod() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(1.0, 6.0, sections=96)


SIMULATED = (
    Contact("gentle press", Press("USB plug", parts.usb_plug, (0.0, 20.0), flat=True), 0.3, _plain),
    Contact(
        "deep press, shear", Press("irregular peg", parts.peg_irregular, (17.0, 34.0)), 1.8, _dragged, 1.2
    ),
    Contact("refraction", Press("square peg", parts.peg_square, (0.0, 8.0)), 1.0, layered_scene),
    Contact("low light", Press("key", parts.key, (2.0, 24.0), flat=True), 1.0, _dim),
    Contact("small part", Press("rod", _rod, (3.0, 3.0)), 0.8, _plain),
    Contact("symmetric part", Press("hexagonal peg", parts.peg_hexagonal, (0.0, 8.0)), 1.0, _plain),
    Contact("dense lattice", Press("round peg", parts.peg_round, (0.0, 8.0)), 1.0, _dense),
)


@cache
def _body(name: str, make: Callable[[], trimesh.Trimesh]) -> Body:
    return Body(name, make())


def simulated_cases() -> list[Case]:
    """All simulated scenes."""
    return [Case(contact.name, "simulated", partial(_take, contact)) for contact in SIMULATED]


def _take(contact: Contact, seed: int) -> Take:
    """Press the part; poses with too few markers in contact are drawn again.

    Raises
    ------
    Error
        No pose of a hundred is a usable contact.
    """
    body = _body(contact.press.name, contact.press.make)
    random = np.random.default_rng([seed, 61])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        body.mesh.export(path)
        indenter = {"kind": "mesh", "path": str(path), "units": "mm"}
        scene = contact.scene().replace({"seed": seed, "indenter": indenter})
        simulator = Simulator(scene)
        for _ in range(100):
            pose = np.array(simulator.pressed(place(contact.press, body.mesh, random), contact.depth_mm))
            if simulator.press(pose).in_contact.sum() >= MIN_TOUCHING:
                break
        else:
            raise Error(f"{contact.name}: no pose of {body.name} touches {MIN_TOUCHING} markers")
        moving = Simulator(scene.replace({"trajectory": _trajectory(contact, pose)}))
    shots = [_shot(moving, index, body) for index in range(len(moving))]
    gel = scene.to_dict()["gel"]
    return Take(
        scene.rig,
        gel["pitch_mm"],
        shots,
        [len(shots) - 1],
        _by_hand(scene, contact.depth_mm),
        contact.scene is layered_scene,
    )


def _trajectory(contact: Contact, pose: np.ndarray) -> list[dict[str, object]]:
    """Keyframes: above the gel, pressed, and dragged along x."""
    lifted, moved = pose.copy(), pose.copy()
    lifted[2, 3] += contact.depth_mm + _CLEARANCE_MM
    moved[0, 3] += contact.shear_mm
    ways = [(0.0, lifted, 0.0), (_PRESS_S, pose, 0.0)]
    if contact.shear_mm:
        ways.append((_PRESS_S + _SHEAR_S, moved, contact.shear_mm))
    return [
        {
            "time_s": time_s,
            "position_mm": at[:3, 3].tolist(),
            "rotation_rad": np.asarray(se3_log(at))[:3].tolist(),
            "shear_mm": [shear_mm, 0.0],
        }
        for time_s, at, shear_mm in ways
    ]


def _shot(simulator: Simulator, index: int, body: Body) -> Shot:
    frame = simulator[index]
    pose = frame.t_sensor_object
    return Shot(
        np.array(frame.left),
        np.array(frame.right),
        np.array(frame.left_px),
        np.array(frame.right_px),
        np.array(frame.points_mm),
        np.ones(len(frame.points_mm), bool),
        np.array(frame.in_contact),
        body,
        None if pose is None else np.array(pose),
    )


def _by_hand(scene: Scene, depth_mm: float) -> dict[str, dict[str, object]]:
    gel = scene.to_dict()["gel"]
    levels = round(_THRESHOLD_SHARE * (gel["bright_level"] - gel["dark_level"]))
    salient_mm = min(_SALIENT_MM, _SALIENT_SHARE * depth_mm)
    return {
        "detect": {"threshold_levels": levels, "min_area_px2": 3},
        "contact": {"saliency_mm": salient_mm},
    }
