"""Third step: what bends the light in front of the cameras."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from gelstereo._native import Frame, Params, Pipeline, PitchWarning, Rig
from gelstereo.calibrate import SeatedFrame, calibrate_layers
from gelstereo.cli.files import read_color_image
from gelstereo.setup.plan import Plan
from gelstereo.setup.step import Figure, Step

__all__ = ["fit", "params_of"]


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
    sigma = {name: float(value) for name, value in found.sigma.items()}
    return Step(
        "layers", "Layers", tuple(figures), doubts, values={"rig": found.rig.to_toml(), "sigma": sigma}
    )
