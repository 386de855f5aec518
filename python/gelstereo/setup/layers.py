"""Third step: what bends the light in front of the cameras."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from gelstereo._native import Frame, Params, Pipeline, PitchWarning, Rig
from gelstereo.calibrate import LayersCalibration, SeatedFrame, calibrate_layers
from gelstereo.cli.files import read_color_image
from gelstereo.setup.plan import Plan
from gelstereo.setup.step import Figure, Step

__all__ = ["fit", "over_plate_sigma_mm", "params_of"]


def params_of(plan: Plan, settings: Mapping[str, Any]) -> Params:
    """The preset with the settings of the print."""
    return Params.preset(plan.preset).replace(dict(settings))


def fit(plan: Plan, rig: Rig, settings: Mapping[str, Any]) -> Step:
    """Fit gap, tilt and indices to the gel at rest and on boards; without boards, keep the design."""
    if plan.layers is None:
        return Step("layers", "Layers", (Figure("layers", "none"),), values={"rig": rig.to_toml()})
    design = rig.with_layers(dict(plan.layers))
    if not plan.boards:
        doubt = "the layers are as designed: images on flat boards of known height would check them"
        return Step("layers", "Layers", (), (doubt,), values={"rig": design.to_toml()})
    params = params_of(plan, settings)
    pipeline = Pipeline(design, params)

    def frame(left: Any, right: Any) -> Frame:
        with warnings.catch_warnings():
            # The layers are not yet known, and the pitch is checked in the next step.
            warnings.simplefilter("ignore", PitchWarning)
            return pipeline.process(read_color_image(left), read_color_image(right))

    frames = [SeatedFrame.from_frame(frame(*pair)) for pair in plan.rest.pairs]
    for height_mm, views in sorted(plan.boards, key=lambda board: board[0]):
        frames += [SeatedFrame.from_frame(frame(*pair), height_mm) for pair in views.pairs]
    found = calibrate_layers(
        design,
        frames,
        pitch_mm=plan.pitch_mm,
        priors=dict(plan.priors),
        sigma_px=params.to_dict()["detect"]["centre_sigma_px"],
    )
    figures = [
        Figure(name, f"{value:.4f} +- {found.sigma[name]:.4f}") for name, value in found.values.items()
    ]
    figures += [
        Figure(
            "pitch along rows",
            f"{found.pitch_mm:.4f} +- {found.pitch_sigma_mm:.4f} mm",
            f"given {plan.pitch_mm[0]}",
        ),
        Figure("print's error", f"{1e3 * found.print_sigma_mm:.1f} um"),
        Figure("residual", f"{found.rms_px:.3f} px rms"),
    ]
    doubts = tuple(str(doubt) for doubt in found.doubts)
    sigma_mm = over_plate_sigma_mm(found)
    figures.append(Figure("print's distance from the plate", f"+- {sigma_mm:.3f} mm"))
    values = {"rig": found.rig.to_toml(), "over_plate_sigma_mm": sigma_mm}
    return Step("layers", "Layers", tuple(figures), doubts, values=values)


def over_plate_sigma_mm(found: LayersCalibration) -> float:
    """Standard deviation of the print's distance from the plate.

    The images fix the reduced distance gap + sum of (thickness / index) + distance / gel index, to first
    order in the rays' angles.
    """
    values, layers = found.values, found.rig.layers
    assert layers is not None
    index, plates = float(layers["gel_index"]), layers["plates"]
    lattice_mm = float(found.t_sensor_lattice[:3, 3] @ np.asarray(layers["normal"], np.float64))
    distance_mm = lattice_mm - float(layers["gap_mm"]) - sum(float(each["thickness_mm"]) for each in plates)
    slopes = {"gap_mm": -index, "gel_index": distance_mm / index}
    for number, plate in enumerate(plates):
        slopes[f"plate_{number}_thickness_mm"] = -index / float(plate["index"])
        slopes[f"plate_{number}_index"] = index * float(plate["thickness_mm"]) / float(plate["index"]) ** 2
    slope = np.array([slopes.get(name, 0.0) for name in values])
    return float(np.sqrt(slope @ found.covariance @ slope))
