"""The paper's contact objects (section V-A; Fig. 9 and 12): sensing and localization.

Each object is pressed into the gel at random poses and random depths. Every preset senses the contact from
the same images and localizes the object from the same guess.
"""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import Error, Frame, Params, Pipeline, SimulatedFrame, Simulator, Template, localize, parts
from gelstereo.geometry import se3_log
from gelstereo.view import Moment, draw
from gelstereo.view.moment import Part, pose_in_words
from gelstereo_bench.experiments.batch import Configuration, Trial, keyed_seed
from gelstereo_bench.experiments.experiment import Experiment
from gelstereo_bench.experiments.objects_report import objects_report
from gelstereo_bench.frontier.grasps import NOISES, STARTS, Grasp, Press, place, surface_normals
from gelstereo_bench.frontier.scenes import SURFACE_MM, VGA

__all__ = ["EXPERIMENT", "OBJECTS", "methods"]

Array = npt.NDArray[np.float64]

#: In the paper's order (a) to (f). All lie on the gel but the card reader, whose slot is pressed.
OBJECTS = (
    Press("M10 screw", parts.screw_m10, (0.0, 3.0)),
    Press("3.5 mm connector", parts.connector_3_5mm, (6.0, 18.0)),
    Press("SD reader", parts.sd_reader, (0.0, 0.0), standing=True),
    Press("key", parts.key, (2.0, 24.0), flat=True),
    Press("irregular part", parts.irregular_part, (0.0, 6.0)),
    Press("USB drive", parts.usb_drive, (2.0, 20.0), flat=True),
)

#: Largest error of the guesses.
START = STARTS[1]
#: Method whose pose is shown in the pictures.
BEST = "exact, surface_search"

_TOUCHING = 20
_PRESS_S = 0.4


def methods() -> dict[str, Params]:
    """Every preset, and the registration with global search on the part's surface."""
    found = {f"preset {name}": Params.preset(name) for name in Params.presets()}
    return found | {BEST: Params.preset("exact").replace({"register": {"method": "surface_search"}})}


def inputs() -> dict[str, str]:
    """The scene and the settings; the objects are part of the package."""
    scene = {"scene": VGA.scene().to_toml()}
    return scene | {f"settings {name}": params.to_toml() for name, params in methods().items()}


def trials(repeats: int, seed: int) -> list[Trial]:
    """Every object, `repeats` times; the first contact of each is shown."""
    return [
        Trial({"object": item.name, "press": press}, keyed_seed(seed, "objects", item.name, press))
        for item in OBJECTS
        for press in range(1, repeats + 1)
    ]


def run(configuration: Configuration, seed: int) -> dict[str, Any]:
    """Press an object once, sense and localize it with every method.

    The record has the depth and the results of each method (``methods``). For the first press it also has the
    ``picture`` (JPEG, base64) and the height of every marker, true and measured.
    """
    item = next(item for item in OBJECTS if item.name == configuration["object"])
    mesh = item.make()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        mesh.export(path)
        simulator, pose = _press(item, mesh, path, seed)
        frames = [simulator[index] for index in range(len(simulator))]
    template = Template.from_mesh(mesh, units="mm", spacing_mm=0.3).with_grid()
    grasp = _grasp(item, mesh, template, pose, frames[-1])
    guess = grasp.guess(START, seed)
    found: dict[str, Any] = {"methods": {}, "depth_mm": _depth_mm(frames[-1])}
    for name, params in methods().items():
        try:
            rest, frame = _sense(simulator, params, frames)
        except Error as error:
            touching = int(frames[-1].in_contact.sum())
            nothing = {"height_um": None, "touching": touching, "salient": 0, "both": 0}
            found["methods"][name] = nothing | {"refused": str(error)}
            continue
        result = _method(grasp, guess, params, frames[-1], frame)
        found["methods"][name] = {key: value for key, value in result.items() if key != "pose"}
        if name == BEST and configuration["press"] == 1:
            found |= _shown(item, grasp, result, frames[-1], rest, frame)
    return found


def _depth_mm(frame: SimulatedFrame) -> float:
    """Indentation of the deepest marker, mm."""
    return round(float(frame.indentation_mm.max()), 6)


def _press(item: Press, mesh: Any, path: Path, seed: int) -> tuple[Simulator, Array]:
    """Simulator of the object moving down along the camera's axis, and the object's final pose."""
    random = np.random.default_rng(seed)
    scene = VGA.scene().replace(
        {"seed": seed, "indenter": {"kind": "mesh", "path": str(path), "units": "mm"}}
    )
    still = Simulator(scene)
    for _ in range(100):
        pose = place(item, mesh, random)
        if still.press(pose).in_contact.sum() >= _TOUCHING:
            break
    else:
        raise Error(f"{item.name} does not touch {_TOUCHING} markers in any of 100 poses (seed {seed})")
    lift_mm = float(still.press(pose).indentation_mm.max()) + 0.2
    turn = [float(angle) for angle in np.asarray(se3_log(pose))[:3]]
    keyframes = [
        {
            "time_s": time_s,
            "position_mm": [float(pose[0, 3]), float(pose[1, 3]), float(pose[2, 3]) + up_mm],
            "rotation_rad": turn,
        }
        for time_s, up_mm in ((0.0, lift_mm), (_PRESS_S, 0.0))
    ]
    return Simulator(scene.replace({"trajectory": keyframes})), pose


def _sense(simulator: Simulator, params: Params, frames: list[SimulatedFrame]) -> tuple[Frame, Frame]:
    """The frame at rest, and the last one."""
    pipeline = Pipeline(simulator.scene.rig, params)
    seen = [pipeline.process(frame.left, frame.right) for frame in frames]
    return seen[0], seen[-1]


def _grasp(item: Press, mesh: Any, template: Template, pose: Array, truth: SimulatedFrame) -> Grasp:
    """The contact with its bound, from the markers truly in contact.

    Determined directions are selected with the noise of docs/localization.md. With the noise of these images,
    a round part's facets, a micrometre high, would appear to determine its spin.
    """
    touching = truth.in_contact
    points_mm = np.asarray(truth.points_mm)[touching]
    normals = np.full_like(truth.points_mm, np.nan)
    normals[touching] = surface_normals(mesh, template, pose, points_mm)
    variance = (NOISES[0].sigma_mm * np.array([0.5, 0.5, 1.0])) ** 2
    covariance = np.broadcast_to(np.diag(variance), (len(points_mm), 3, 3))
    return Grasp(item.name, mesh, template, points_mm, covariance, truth.points_mm, normals, pose)


def _method(
    grasp: Grasp, guess: Array, params: Params, truth: SimulatedFrame, frame: Frame
) -> dict[str, Any]:
    height_mm = SURFACE_MM - frame.points_mm[:, 2]
    touching, salient = truth.in_contact, frame.salient
    out: dict[str, Any] = {
        "height_um": round(1e3 * float(np.sqrt(np.mean((height_mm - truth.indentation_mm) ** 2))), 3),
        "touching": int(touching.sum()),
        "salient": int(salient.sum()),
        "both": int((touching & salient).sum()),
    }
    try:
        found = localize(frame, grasp.template, guess=guess, params=params)
    except Error as error:
        return out | {"refused": str(error)}
    score = grasp.score(found.t_sensor_object)
    return out | {
        "angle_deg": round(score.angle_deg, 6),
        "shift_mm": round(score.shift_mm, 6),
        "observable": score.observable,
        "free": len(found.free),
        "within": bool(score.success),
        "pose": found.t_sensor_object,
    }


def _shown(
    item: Press, grasp: Grasp, result: dict[str, Any], truth: SimulatedFrame, rest: Frame, frame: Frame
) -> dict[str, Any]:
    """Data of the first press for the report's pictures."""
    pose = result.get("pose")
    part = None if pose is None else Part.located(grasp.mesh.vertices, grasp.mesh.faces, pose)
    found = "refused" if pose is None else f"{pose_in_words(pose)} found"
    notes = (f"{pose_in_words(grasp.t_sensor_object)} in truth", found)
    moment = Moment.of(
        truth.left, frame, rest.left_px, (frame.rows, frame.cols), part=part, title=item.name, notes=notes
    )
    # Camera noise makes a PNG three times as large.
    done, picture = cv2.imencode(".jpg", draw(moment), [cv2.IMWRITE_JPEG_QUALITY, 88])
    assert done
    height_mm = SURFACE_MM - frame.points_mm[:, 2]
    return {
        "picture": base64.b64encode(picture.tobytes()).decode("ascii"),
        "rows": frame.rows,
        "cols": frame.cols,
        "truth_mm": [round(float(value), 5) for value in truth.indentation_mm],
        "found_mm": [round(float(value), 5) for value in height_mm],
        "touching": [int(value) for value in truth.in_contact],
        "salient": [int(value) for value in frame.salient],
    }


EXPERIMENT = Experiment(
    name="objects",
    repeats=5,
    inputs=inputs,
    trials=trials,
    run=run,
    report=lambda trials, records: objects_report(
        trials, records, inputs(), {item.name: item.make for item in OBJECTS}
    ),
)
