"""The simulated sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gelstereo._native import Plan, Scene, Simulator


def simulate(scene: Scene | str | Path | Mapping[str, Any]) -> Simulator:
    """Make a scene ready to run; what of its frames is read is computed, and nothing else.

    Parameters
    ----------
    scene
        A `Scene`; a path to a TOML file (a ``Path``, or a ``str`` that ends in ``.toml``); TOML text; or a mapping
        of settings that replace those of the default scene, nested or with dotted names.

    Returns
    -------
    Simulator
        A sequence of `SimulatedFrame`: both images and the truth behind them. Markers in space are worked out with the
        frame, what the cameras see of them when any of it is read, and images when one of the two is.

    Raises
    ------
    SceneError
        If the scene makes no sense; unknown names are refused with the valid ones.
    OSError
        If the file cannot be read.
    """
    if isinstance(scene, Path) or (isinstance(scene, str) and scene.strip().endswith(".toml")):
        scene = Scene.load(scene)
    elif isinstance(scene, str):
        scene = Scene.from_toml(scene)
    elif isinstance(scene, Mapping):
        scene = Scene().replace(scene)
    return Simulator(scene)


def plan_record(plan: Plan) -> dict[str, Any]:
    """A plan as JSON can hold it: sums and a dictionary per effect; a bound that nobody knows is ``None``."""

    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None

    effects = [
        {
            "name": effect.name,
            "on": effect.on,
            "why": effect.why,
            "bound_px": known(effect.bound_px),
            "bound_um": known(effect.bound_um),
            "bound_levels": known(effect.bound_levels),
            "cost_ns": effect.cost_ns,
        }
        for effect in plan.effects
    ]
    return {"left_out": plan.left_out, "cost_ns": plan.cost_ns, "effects": effects}
