"""One sample of a data set: a random scene with the frames of its trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import RandomStream, SimulatedFrame, Simulator
from gelstereo.randomization import Distribution

Array = npt.NDArray[Any]

#: As those of scenes: exact in any format.
_SEEDS = 2**53


@dataclass(frozen=True)
class Sample:
    """A random scene and its frames: T of them, N markers, images of H by W pixels.

    Attributes
    ----------
    index : int
        Number of the sample in the data set.
    seed : int
        ``simulator.randomize(distribution, seed)`` simulates it again.
    frames : dict of (T, ...) ndarray
        - ``time_s``: (T,)
        - ``left``, ``right``: (T, H, W) uint8
        - ``points_mm``, ``displacement_mm``: (T, N, 3) markers in the sensor frame, and their motion since
          rest; N = rows * cols, row by row
        - ``in_contact``: (T, N) bool
        - ``t_sensor_object``: (T, 4, 4), of a scene with a part
        - with an elastic layer: ``traction_kpa`` (T, N, 3) and ``stick`` (T, N) uint8 (`gelstereo.Stick`),
          and the wrench ``force_n`` and ``torque_nmm`` (T, 3), about the origin of the sensor frame
        - of a scene with P parts, more than one: ``t_sensor_objects`` (T, P, 4, 4), NaN for a part that is
          away; ``touched_by`` (T, N) int64, the number of the part at each marker, or -1; and with an elastic
          layer ``part_force_n`` and ``part_torque_nmm`` (T, P, 3), the wrench of each part
    rest : dict of ndarray
        ``left`` and ``right``, (H, W) uint8, and ``points_mm``, (N, 3): the same gel without contact.
    rows, cols : int
        Lattice of the markers.
    pitch_mm : float or [float, float]
        Of the drawn scene; two numbers of a rectangular print. Of a hexagonal one: the distance along a row,
        and that of the rows.
    frame_rate_hz : float
        Of the drawn scene.
    """

    index: int
    seed: int
    frames: dict[str, Array]
    rest: dict[str, Array]
    rows: int
    cols: int
    pitch_mm: float | list[float]
    frame_rate_hz: float


def sample_seed(seed: int, index: int) -> int:
    """Seed of one sample of a data set."""
    return RandomStream(seed, f"sample {index}").below(_SEEDS)


def simulate_sample(
    simulator: Simulator, distribution: Distribution, seed: int, *, index: int = 0, images: bool = True
) -> Sample:
    """Draw a scene and simulate all of its frames.

    Parameters
    ----------
    simulator
        Simulator of the scene that varies.
    distribution
        What varies.
    seed
        Seed of the draw.
    index
        Number of the sample.
    images
        Whether images are rendered.

    Raises
    ------
    DistributionError
        If the draw is not valid.
    """
    drawn = simulator.randomize(distribution, seed)
    settings = drawn.scene.to_dict()
    # A frame number of its own gives the rest images noise of their own.
    at_rest = drawn.press(frame=len(drawn))
    frames = [_values(frame, at_rest, images) for frame in drawn]
    rest: dict[str, Array] = {"points_mm": at_rest.points_mm}
    if images:
        rest |= {"left": at_rest.left, "right": at_rest.right}
    gel = settings["gel"]
    pitch_mm = gel["pitch_mm"]
    if gel["layout"] == "hexagonal":
        pitch_mm = [pitch_mm, math.sqrt(0.75) * pitch_mm]
    stacked = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    return Sample(index, seed, stacked, rest, gel["rows"], gel["cols"], pitch_mm, settings["frame_rate_hz"])


def _values(frame: SimulatedFrame, at_rest: SimulatedFrame, images: bool) -> dict[str, Array]:
    out: dict[str, Array] = {"time_s": np.float64(frame.time_s)}
    if images:
        out |= {"left": frame.left, "right": frame.right}
    out |= {
        "points_mm": frame.points_mm,
        "displacement_mm": frame.points_mm - at_rest.points_mm,
        "in_contact": frame.in_contact,
    }
    if frame.t_sensor_object is not None:
        out["t_sensor_object"] = frame.t_sensor_object
    poses = frame.t_sensor_objects
    if len(poses) > 1:
        away = np.full((4, 4), np.nan)
        out["t_sensor_objects"] = np.stack([away if pose is None else pose for pose in poses])
        out["touched_by"] = frame.touched_by
    loads = frame.loads
    if loads is not None:
        # The torque about another point differs by the moment of the force.
        torque_nmm = loads.torque_nmm + np.cross(loads.about_mm, loads.force_n)
        out |= {"traction_kpa": loads.traction_kpa, "stick": loads.stick}
        out |= {"force_n": loads.force_n, "torque_nmm": torque_nmm}
        if len(poses) > 1:
            moment_nmm = np.cross(loads.about_mm, loads.part_force_n)
            out["part_force_n"] = loads.part_force_n
            out["part_torque_nmm"] = loads.part_torque_nmm + moment_nmm
    return out
