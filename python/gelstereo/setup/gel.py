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
from gelstereo.setup import law
from gelstereo.setup.layers import params_of
from gelstereo.setup.plan import Plan
from gelstereo.setup.prints import outline_px, pitch_setting
from gelstereo.setup.sensor import Sensor
from gelstereo.setup.step import Figure, Step
from gelstereo.states import MarkerState

__all__ = ["presses", "rest"]

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

#: Frames from which a standard deviation per marker is known to a quarter.
MIN_FRAMES = 10
#: Frames of the simulated sensor at rest.
SIMULATED_FRAMES = 30
#: A sensor whose noise is larger than the simulated one's by this factor has another fault than noise.
MAX_OVER_SIMULATED = 2.0
#: Standard deviation of a decay length that is used, over the length: a length that is too short by more than
#: a tenth makes the whole shoulder a contact (contact/decay.rs).
MAX_DECAY_SIGMA = 0.03
#: Presses of this depth or deeper tell a decay length, if the gel has one.
MIN_PRESS_MM = 0.5
#: Share of the pixels at the largest grey level from which centres suffer.
MAX_SATURATED = 0.001


_NAMES = {
    "decay_mm": "decay length",
    "shoulder_mm": "shoulder beside a contact",
    "depth_mm": "depth of the print",
    "thickness_mm": "thickness",
    "friction": "friction",
    "pull_off_mm2": "pull-off over Young's modulus",
}


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
    is_hexagonal = pipeline.params.to_dict()["lattice"]["layout"] == "hexagonal"
    gel = _gel(plan, found, last, is_hexagonal)
    sensor = Sensor(rig, pipeline.params, gel)
    simulated_mm = _simulated(sensor).measured_mm
    saturated = _saturated(read_color_image(plan.rest.left[0]), np.asarray(last.left_px))
    figures = [
        Figure("frames", f"{len(frames)}", f"{MIN_FRAMES} or more"),
        Figure("stated depth noise", f"{1e3 * found.stated_mm:.1f} um"),
        Figure("measured depth noise", _um(found.measured_mm), f"simulated {_um(simulated_mm)}"),
        Figure("drift of the depth", _um(found.drift_mm)),
        Figure("markers not seen", f"{100 * found.hidden:.1f} %"),
        Figure("pixels of the gel at the limit", f"{100 * saturated:.2f} %", "below 0.1 %"),
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
    if found.measured_mm > MAX_OVER_SIMULATED * simulated_mm:
        doubts.append("the noise is larger than simulated: check light, focus and that nothing moves")
    if saturated > MAX_SATURATED:
        doubts.append("the image is too bright in places: shorten the exposure or dim the light")
    return Step("rest", "Gel at rest", tuple(figures), tuple(doubts), values={"gel": gel})


def presses(
    plan: Plan, rig: Rig, settings: Mapping[str, Any], over_plate_sigma_mm: float | None = None
) -> Step:
    """The gel's own lengths, with their uncertainty, and what these presses do not tell."""
    if plan.presses is None:
        raise ValueError("the plan has no presses")
    params = params_of(plan, settings)
    learns = {"contact.saliency": "pressure", "contact.learn_decay": True}
    pipeline = Pipeline(rig, params.replace(learns))
    deepest_mm, touching, unidentified = 0.0, 0, 0
    pressed: list[Frame] = []
    images = [tuple(map(read_color_image, pair)) for pair in plan.presses.pairs]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PitchWarning)
        for left, right in progress(images, "sensing the presses"):
            frame = pipeline.process(left, right)
            salient = np.asarray(frame.salient)
            touching += int(salient.any())
            if salient.any():
                pressed.append(frame)
            unidentified += int((np.asarray(frame.state) != MarkerState.SEEN).all())
            deepest_mm = max(deepest_mm, float(np.max(np.asarray(frame.indentation_mm))))
    count = len(plan.presses.pairs)
    figures = [
        Figure("frames with contact", f"{touching} of {count}"),
        Figure("deepest indentation", f"{deepest_mm:.2f} mm"),
    ]
    doubts: list[str] = []
    if unidentified:
        doubts.append(f"in {unidentified} frames no marker was identified: press more slowly")
    decay = pipeline.decay_mm
    if decay is None and deepest_mm >= MIN_PRESS_MM and touching >= law.MIN_FRAMES:
        length = law.GelLength.assumed(
            "decay_mm", "no length describes the gel beside these contacts; saliency by adaptive needs none"
        )
    elif decay is None:
        doubts.append("the gel's decay length was not learned: press a part of known shape, 0.5 mm or deeper")
        length = law.GelLength.assumed("decay_mm", "press a part of known shape, 0.5 mm or deeper")
    else:
        if decay[1] > MAX_DECAY_SIGMA * decay[0]:
            doubts.append("the presses hardly determine the decay length: press more, and deeper")
        length = law.GelLength("decay_mm", decay[0], decay[1], True, "heights beside the contacts")
    lengths = [length, *_lengths(plan, pipeline, pressed, images, over_plate_sigma_mm)]
    figures += [
        Figure(_NAMES[each.name], str(each), each.why if each.learned else f"assumed: {each.why}")
        for each in lengths
    ]
    advice = tuple(f"{_NAMES[each.name]} is assumed: {each.why}" for each in lengths if not each.learned)
    gel: dict[str, Any] = {}
    for each in lengths:
        gel |= each.values()
    gel["learned"] = [each.name for each in lengths if each.learned]
    return Step("presses", "Gel under a part", tuple(figures), tuple(doubts), advice, {"gel": gel})


def _lengths(
    plan: Plan, pipeline: Pipeline, pressed: list[Frame], images: list[Any], over_plate_sigma_mm: float | None
) -> list[law.GelLength]:
    """All lengths but the decay."""
    rest, rig = pipeline.rest, pipeline.rig
    if rest is None or not pressed:
        why = "no frame shows a contact"
        return [law.GelLength.assumed(name, why) for name in law.ASSUMED if name != "decay_mm"]
    params = pipeline.params
    given_mm = float(params.to_dict()["lattice"]["depth_mm"])
    # Points are those of the skin where a depth is given.
    print_mm = law.over_plate(rig, rest, over_plate_sigma_mm, given_mm)
    if plan.thickness_mm is not None and given_mm == 0.0:
        depth, thickness = law.by_thickness(print_mm, plan.thickness_mm)
    else:
        depth = law.depth_of(rest, pressed, pressed[0].cols, plan.ball_radius_mm, given_mm)
        thickness = law.thickness_of(print_mm, depth)
    shoulder = law.shoulder_of(rest, pressed, float(np.mean(plan.pitch_mm)))
    return [shoulder, depth, thickness, *law.slides(images, rig, params, thickness)]


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


def _gel(plan: Plan, found: _Rest, frame: Frame, is_hexagonal: bool) -> dict[str, Any]:
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
        **(_odd_rows(frame) if is_hexagonal else {}),
        "noise_levels": round(float(seen.noise), 2),
        "point_sigma_mm": round(point, 6),
    }


def _odd_rows(frame: Frame) -> dict[str, bool]:
    """How the odd rows of a hexagonal print stand to the even ones."""
    rows_mm = frame.points_mm.reshape(frame.rows, frame.cols, 3)
    along_mm = np.mean(rows_mm[:, -1] - rows_mm[:, 0], axis=0)
    starts = rows_mm.mean(axis=1) @ along_mm
    # Beside the mean of the rows above and below, so that a slanted view does not count.
    beside = starts[1:-1] - 0.5 * (starts[:-2] + starts[2:])
    return {"odd_rows_forward": bool(np.sum(beside * (-1.0) ** np.arange(len(beside))) > 0.0)}


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


def _saturated(image: Image, markers_px: Array) -> float:
    """Share of the pixels among the markers that are at the largest grey level; lamps lie beside the gel."""
    low = np.maximum(np.floor(markers_px.min(axis=0)).astype(int), 0)
    high = np.ceil(markers_px.max(axis=0)).astype(int) + 1
    return float(np.mean(image[low[1] : high[1], low[0] : high[0]] == 255))


def _um(length_mm: float) -> str:
    return f"{1e3 * length_mm:.1f} um" if np.isfinite(length_mm) else "unknown"
