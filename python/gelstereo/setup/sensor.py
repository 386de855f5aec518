"""The sensor file: rig, settings and measured lengths of one sensor."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelstereo._native import Error, Params, Rig, Scene, parse_toml

__all__ = ["Sensor", "SensorFileError", "load_sensor", "sensor_text"]


class SensorFileError(Error):
    """A file is not a sensor file."""


@dataclass(frozen=True)
class Sensor:
    """A sensor that was set up.

    Attributes
    ----------
    rig, params
        For `Pipeline`.
    gel
        Measured: ``rows``, ``cols``, ``pitch_mm``, ``dot_radius_mm``, ``surface_mm`` (distance of the markers
        at rest), ``centre_mm``, ``noise_levels`` and ``point_sigma_mm``; of a hexagonal print also
        ``odd_rows_forward``, as in a scene's gel. If presses were given, the gel's own
        lengths follow, each with its standard deviation (``decay_mm`` and ``decay_sigma_mm``): ``decay_mm``,
        ``shoulder_mm``, ``depth_mm``, ``thickness_mm``, ``friction`` and ``pull_off_mm2``. ``learned`` names
        those that the presses tell; the others are assumed.
    """

    rig: Rig
    params: Params
    gel: Mapping[str, Any]

    def scene(self) -> Scene:
        """The sensor as a scene of the simulator, at rest: its cameras, layers, print and noise.

        Add an indenter, a trajectory and effects by `Scene.replace`. The gel's law is the simulator's.
        """
        names = ["rows", "cols", "pitch_mm", "dot_radius_mm", "surface_mm", "centre_mm"]
        names += ["thickness_mm"] if "thickness_mm" in self.gel.get("learned", ()) else []
        names += ["odd_rows_forward"] if "odd_rows_forward" in self.gel else []
        gel = {name: self.gel[name] for name in names}
        gel["layout"] = self.params.to_dict()["lattice"]["layout"]
        effects = {"defocus": {}, "sensor_noise": {"sigma_levels": self.gel["noise_levels"]}}
        bright = self.params.to_dict()["detect"]["polarity"] == "bright"
        return Scene().replace(
            {
                "rig": parse_toml(self.rig.to_toml()),
                "gel": {**gel, "bright_dots": bright},
                "effects": effects,
            }
        )


def load_sensor(path: str | Path) -> Sensor:
    """Open a sensor file that `gelstereo setup` wrote.

    Raises
    ------
    SensorFileError
        A part of the file is missing.
    """
    path = Path(path)
    tree = parse_toml(path.read_text(encoding="utf-8"))
    missing = [name for name in ("preset", "rig", "gel") if name not in tree]
    if missing:
        raise SensorFileError(
            f"{path} has no {missing[0]!r}, so it is no sensor file; `gelstereo setup` writes one"
        )
    rig = Scene().replace({"rig": tree["rig"]}).rig
    return Sensor(rig, Params.preset(tree["preset"]).replace(tree.get("params", {})), tree["gel"])


def sensor_text(rig: Rig, preset: str, settings: Mapping[str, Any], gel: Mapping[str, Any]) -> str:
    """Text of a sensor file; `settings` are differences from the preset by dotted names."""
    lines = ["# Written by `gelstereo setup`.", f"preset = {_toml(preset)}", "", "[gel]"]
    lines += [f"{name} = {_toml(value)}" for name, value in gel.items()]
    tables: dict[str, list[str]] = {}
    for name, value in settings.items():
        table, _, key = name.rpartition(".")
        tables.setdefault(table, []).append(f"{key} = {_toml(value)}")
    for table, entries in tables.items():
        lines += ["", f"[params.{table}]", *entries]
    nested = re.sub(r"^(\[+)", r"\1rig.", rig.to_toml(), flags=re.MULTILINE)
    return "\n".join([*lines, "", nested])


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(each) for each in value) + "]"
    return repr(value)
