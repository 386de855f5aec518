"""The command ``gelstereo demo``: the whole pipeline on a simulated sensor, through the public functions
alone.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Error,
    Frame,
    Localization,
    Params,
    Pipeline,
    SimulatedFrame,
    Template,
    localize,
    simulate,
)
from gelstereo.cli.files import write_image
from gelstereo.cli.options import add_params, params_of
from gelstereo.geometry import se3_exp, se3_log, shape_mesh
from gelstereo.progress import progress

EXAMPLES = """examples:
  gelstereo demo
  gelstereo demo --preset paper --output paper.png
"""

Floats = npt.NDArray[np.float64]

#: A peg of 8 mm diameter, pressed 2 mm deep and then dragged by its weight. It is longer than the lattice is
#: wide, so neither end touches the gel, and translation along its axis is undetermined.
_SIDEWAYS = [0.0, 1.5707963267948966, 0.0]
SCENE: dict[str, Any] = {
    "indenter": {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 40.0},
    "effects": {
        name: {}
        for name in ("shoulder", "spread", "drag", "uneven_light", "grain", "defocus", "sensor_noise")
    },
    "trajectory": [
        {"time_s": 0.0, "position_mm": [4.0, 0.0, 33.0], "rotation_rad": _SIDEWAYS},
        {"time_s": 0.7, "position_mm": [4.0, 0.0, 30.7], "rotation_rad": _SIDEWAYS},
        {"time_s": 1.0, "position_mm": [4.0, 0.8, 30.7], "rotation_rad": _SIDEWAYS, "shear_mm": [0.0, 0.8]},
    ],
}

#: Error of the initial guess: degrees about x, y, z and millimetres along them.
_GUESS_DEG, _GUESS_MM = (1.5, 2.0, -2.0), (0.5, -0.5, 0.3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--output", type=Path, default=Path("gelstereo-demo.png"), help="picture (%(default)s)"
    )
    add_params(parser)


def run(arguments: argparse.Namespace) -> int:
    """Press, locate, draw; return the exit code."""
    from gelstereo.view import Moment, draw
    from gelstereo.view.moment import Part, pose_in_words

    params = params_of(arguments)
    rest, frame, moment, milliseconds = press(params)
    vertices_mm, triangles = shape_mesh(SCENE["indenter"], 0.01)
    template = Template.from_triangles(vertices_mm, triangles)
    found, spent = locate(frame, moment, template, params)
    angle_deg, distance_mm = error_of(found, moment.t_sensor_object)
    free = "; ".join(map(str, found.free)) or "nothing"
    picture = Moment.of(
        moment.left,
        frame,
        rest.left_px,
        (frame.rows, frame.cols),
        part=Part.located(vertices_mm, triangles, found.t_sensor_object),
        title="A peg located in the hand (simulated sensor)",
        notes=(pose_in_words(found.t_sensor_object), f"free, object frame: {free}"),
    )
    write_image(arguments.output, draw(picture))
    print(
        f"sensing    {milliseconds:.1f} ms a stereo frame; {frame.motion_px:.1f} px of motion, "
        f"{found.points} points"
    )
    print(f"located    {pose_in_words(found.t_sensor_object)} in {spent:.1f} ms, {found!r}")
    print(f"free       {free}")
    print(f"error      {angle_deg:.3f} deg, {distance_mm:.4f} mm in the determined directions (simulated)")
    print(f"picture    {arguments.output}")
    return 0


def press(params: Params) -> tuple[Frame, Frame, SimulatedFrame, float]:
    """Close on the part until the grasp trigger; return the rest frame, the last frame with its truth, and
    milliseconds per frame.
    """
    simulator = simulate(SCENE)
    pipeline = Pipeline(simulator.scene.rig, params)
    trigger_px = params.to_dict()["contact"]["grasp_trigger_px"]
    rest, times = None, list[float]()
    for moment in progress(simulator, "pressing"):
        start = time.perf_counter()
        frame = pipeline.process(moment.left, moment.right)
        times.append(1e3 * (time.perf_counter() - start))
        rest = rest or frame
        if frame.motion_px >= trigger_px:
            break
    if rest is None:
        raise Error("the scene has no frames")
    return rest, frame, moment, float(np.median(times))


def locate(
    frame: Frame, moment: SimulatedFrame, template: Template, params: Params
) -> tuple[Localization, float]:
    """Localize from a perturbed guess; also return the time in milliseconds."""
    assert moment.t_sensor_object is not None  # the scene has an indenter
    guess = moment.t_sensor_object @ se3_exp([*np.radians(_GUESS_DEG), *_GUESS_MM])
    start = time.perf_counter()
    found = localize(frame, template, guess=guess, params=params)
    return found, 1e3 * (time.perf_counter() - start)


def error_of(found: Localization, truth: Floats | None) -> tuple[float, float]:
    """Angle (degrees) and distance at the patch (mm) from the truth, over the determined directions."""
    assert truth is not None
    centre = found.free[0].centre_mm if found.free else np.zeros(3)
    here, back = np.eye(4), np.eye(4)
    here[:3, 3], back[:3, 3] = centre, -centre
    # In the object's frame about the patch, as the free directions are.
    twist = np.array(se3_log(back @ np.linalg.inv(found.t_sensor_object) @ truth @ here))
    if found.free:
        free = np.stack([np.concatenate([direction.omega, direction.v]) for direction in found.free])
        basis, _ = np.linalg.qr(free.T)
        twist -= basis @ (basis.T @ twist)
    return float(np.degrees(np.linalg.norm(twist[:3]))), float(np.linalg.norm(twist[3:]))
