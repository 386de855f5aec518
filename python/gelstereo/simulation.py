"""The simulated sensor."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gelstereo._native import Plan, Scene, SceneError, Simulator

#: Scenes that come with the package.
SCENES = Path(__file__).parent / "scenes"


def shipped_scene(name: str) -> Path:
    """The file of a scene that comes with the package.

    Raises
    ------
    SceneError
        If there is none of that name; the message lists them.
    """
    path = SCENES / f"{name}.toml"
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in SCENES.glob("*.toml")))
        raise SceneError(
            f"no scene {name!r} comes with gelstereo; valid is one of {names}, or a path to a TOML file"
        )
    return path


def simulate(scene: Scene | str | Path | Mapping[str, Any]) -> Simulator:
    """Create a simulator of a scene. Frames are computed lazily: only the results that are read.

    Parameters
    ----------
    scene
        A `Scene`; the name of a scene that comes with the package, such as ``"grasp_cylinder"``; a path to a
        TOML file (a ``Path``, or a ``str`` that ends in ``.toml``); TOML text; or a mapping of settings,
        nested or with dotted names, that replace those of the default scene.

    Returns
    -------
    Simulator
        A sequence of `SimulatedFrame`: both images and their ground truth. Markers in space are computed with
        the frame, the camera views when one of their values is read, and the images when one of them is read.

    Raises
    ------
    SceneError
        If the scene is not valid; for an unknown name, the message lists the valid ones.
    OSError
        If the file cannot be read.
    """
    if isinstance(scene, str) and re.fullmatch(r"\w+", scene):
        scene = shipped_scene(scene)
    if isinstance(scene, Path) or (isinstance(scene, str) and scene.strip().endswith(".toml")):
        scene = Scene.load(scene)
    elif isinstance(scene, str):
        scene = Scene.from_toml(scene)
    elif isinstance(scene, Mapping):
        scene = Scene().replace(scene)
    return Simulator(scene)


def plan_record(plan: Plan) -> dict[str, Any]:
    """A plan in JSON-compatible form: sums, and a dictionary per effect; an unknown bound is ``None``."""

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
