"""The simulated sensor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gelstereo._native import Scene, Simulator


def simulate(scene: Scene | str | Path | Mapping[str, Any]) -> Simulator:
    """Make a scene ready to run; its frames are rendered when they are asked for.

    Parameters
    ----------
    scene
        A `Scene`; a path to a TOML file (a ``Path``, or a ``str`` that ends in ``.toml``); TOML text; or a mapping
        of settings that replace those of the default scene, nested or with dotted names.

    Returns
    -------
    Simulator
        A sequence of `SimulatedFrame`: both images and the truth behind them.

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
