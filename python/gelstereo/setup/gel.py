"""Fourth and fifth step: the gel at rest, and under a part."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Frame, Pipeline, PitchWarning, Rig, Simulator
from gelstereo.cli.files import read_color_image
from gelstereo.inspection import inspect
from gelstereo.progress import progress
from gelstereo.setup.layers import params_of
from gelstereo.setup.plan import Plan
from gelstereo.setup.prints import outline_px, pitch_setting
from gelstereo.setup.sensor import Sensor
from gelstereo.setup.step import Figure, Step
from gelstereo.states import MarkerState

__all__ = ["presses", "rest"]

Array = npt.NDArray[np.float64]

#: Frames from which a standard deviation per marker is known to a quarter.
MIN_FRAMES = 10
#: Frames of the simulated sensor at rest.
SIMULATED_FRAMES = 30
#: A sensor whose noise is larger than the simulated one's by this factor has another fault than noise.
MAX_OVER_SIMULATED = 2.0
#: Standard deviation of a decay length that is used, over the length: a length that is too short by more than
#: a tenth makes the whole shoulder a contact (contact/decay.rs).
MAX_DECAY_SIGMA = 0.03
#: Share of the pixels at the largest grey level from which centres suffer.
MAX_SATURATED = 0.001


@dataclass
class _Rest:
    """Noise of the markers over frames at rest."""

    stated_mm: float
    #: Standard deviation over frames of a marker's depth, rms over markers; NaN for a few frames.
    measured_mm: float
    #: Mean depth of all markers in the last third of the frames, minus that in the first third.
    drift_mm: float
    points_mm: Array
    hidden: float


def rest(plan: Plan, rig: Rig, settings: Mapping[str, Any]) -> Step:
    """Noise, drift, pitch and exposure at rest, beside a simulated sensor of this geometry."""
    pipeline = Pipeline(rig, params_of(plan, settings))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PitchWarning)
        frames = [
            pipeline.process(read_color_image(left), read_color_image(right))
            for left, right in progress(plan.rest.pairs, "sensing the gel at rest")
        ]
    found, last = _noise(frames), frames[-1]
    gel = _gel(plan, found, last)
    sensor = Sensor(rig, pipeline.params, gel)
    simulated = _simulated(sensor)
    saturated = float(np.mean(read_color_image(plan.rest.left[0]) == 255))
    figures = [
        Figure("frames", f"{len(frames)}", f"{MIN_FRAMES} or more"),
        Figure("stated depth noise", f"{1e3 * found.stated_mm:.1f} um"),
        Figure("measured depth noise", _um(found.measured_mm), f"simulated {_um(simulated.measured_mm)}"),
        Figure("drift of the depth", _um(found.drift_mm)),
        Figure("markers not seen", f"{100 * found.hidden:.1f} %"),
        Figure("pixels at the limit", f"{100 * saturated:.2f} %", "below 0.1 %"),
    ]
    doubts = []
    if len(frames) < MIN_FRAMES:
        doubts.append(f"{len(frames)} frames at rest do not show the noise: take {MIN_FRAMES} or more")
    check = pipeline.pitch_check
    if check is not None:
        axes = zip(("rows", "columns"), check.measured_mm, check.sigma_mm, check.expected_mm, strict=True)
        figures += [
            Figure(f"pitch along {axis}", f"{mm:.4f} +- {sigma_mm:.4f} mm", f"given {given_mm}")
            for axis, mm, sigma_mm, given_mm in axes
        ]
        if check.is_off:
            doubts.append(f"the pitch is not as given: {check}")
    if found.measured_mm > MAX_OVER_SIMULATED * simulated.measured_mm:
        doubts.append("the noise is larger than simulated: check light, focus and that nothing moves")
    if saturated > MAX_SATURATED:
        doubts.append("the image is too bright in places: shorten the exposure or dim the light")
    return Step("rest", "Gel at rest", tuple(figures), tuple(doubts), values={"gel": gel})


def presses(plan: Plan, rig: Rig, settings: Mapping[str, Any]) -> Step:
    """The gel's decay length beside a part, with its uncertainty."""
    if plan.presses is None:
        raise ValueError("the plan has no presses")
    learns = {"contact.saliency": "pressure", "contact.learn_decay": True}
    pipeline = Pipeline(rig, params_of(plan, settings).replace(learns))
    deepest_mm, touching, unidentified = 0.0, 0, 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PitchWarning)
        for left, right in progress(plan.presses.pairs, "sensing the presses"):
            frame = pipeline.process(read_color_image(left), read_color_image(right))
            salient = np.asarray(frame.salient)
            touching += int(salient.any())
            unidentified += int((np.asarray(frame.state) != MarkerState.SEEN).all())
            deepest_mm = max(deepest_mm, float(np.max(np.asarray(frame.indentation_mm))))
    count = len(plan.presses.pairs)
    figures = [
        Figure("frames with contact", f"{touching} of {count}"),
        Figure("deepest indentation", f"{deepest_mm:.2f} mm"),
    ]
    doubts, gel = [], {}
    if unidentified:
        doubts.append(f"in {unidentified} frames no marker was identified: press more slowly")
    decay = pipeline.decay_mm
    if decay is None:
        doubts.append("the gel's decay length was not learned: press a part of known shape, 0.5 mm or deeper")
    else:
        gel = {"decay_mm": round(decay[0], 4), "decay_sigma_mm": round(decay[1], 4)}
        if decay[1] > MAX_DECAY_SIGMA * decay[0]:
            doubts.append("the presses hardly determine the decay length: press more, and deeper")
        figures.append(Figure("decay length", f"{decay[0]:.2f} +- {decay[1]:.2f} mm"))
    return Step("presses", "Gel under a part", tuple(figures), tuple(doubts), values={"gel": gel})


def _noise(frames: list[Frame]) -> _Rest:
    points_mm = np.stack([np.asarray(frame.points_mm) for frame in frames])
    seen = np.stack([np.asarray(frame.state) == MarkerState.SEEN for frame in frames])
    depth_mm = np.where(seen, points_mm[:, :, 2], np.nan)
    whole = seen.all(axis=0)
    variance = np.asarray(frames[-1].covariance_mm2)[whole, 2, 2]
    measured_mm = float("nan")
    third = max(len(frames) // 3, 1)
    if len(frames) > 1 and whole.any():
        measured_mm = float(np.sqrt(np.mean(np.var(depth_mm[:, whole], axis=0, ddof=1))))
    drift_mm = float(np.mean(depth_mm[-third:, whole]) - np.mean(depth_mm[:third, whole]))
    return _Rest(
        float(np.sqrt(np.mean(variance))), measured_mm, drift_mm, points_mm.mean(axis=0), 1.0 - seen.mean()
    )


def _gel(plan: Plan, found: _Rest, frame: Frame) -> dict[str, Any]:
    seen = inspect(
        read_color_image(plan.rest.left[0]), preset=plan.preset, outline_px=outline_px(plan, "left")
    )
    middle = found.points_mm.mean(axis=0)
    radius_mm = 0.5 * seen.dot_px / np.mean(seen.layout.spacing_px) * np.mean(plan.pitch_mm)
    point = found.measured_mm if np.isfinite(found.measured_mm) else found.stated_mm
    return {
        "rows": frame.rows,
        "cols": frame.cols,
        "pitch_mm": pitch_setting(plan),
        "dot_radius_mm": round(float(radius_mm), 4),
        "surface_mm": round(float(middle[2]), 4),
        "centre_mm": [round(float(middle[0]), 4), round(float(middle[1]), 4)],
        "noise_levels": round(float(seen.noise), 2),
        "point_sigma_mm": round(point, 6),
    }


def _simulated(sensor: Sensor) -> _Rest:
    """A simulated sensor of this geometry and noise, at rest."""
    scene = sensor.scene()
    simulator = Simulator(scene)
    pipeline = Pipeline(
        sensor.rig, sensor.params.replace({"lattice.pitch_mm": scene.to_dict()["gel"]["pitch_mm"]})
    )
    frames = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PitchWarning)
        for n in range(SIMULATED_FRAMES):
            pair = simulator.press(frame=n)
            frames.append(pipeline.process(pair.left, pair.right))
    return _noise(frames)


def _um(length_mm: float) -> str:
    return f"{1e3 * length_mm:.1f} um" if np.isfinite(length_mm) else "unknown"
