"""Rig and part of a recording, from its embedded configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Rig, Scene, shape_mesh
from gelstereo.extras import needs
from gelstereo.view.mcap_file import Header

Floats = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int64]

#: Tolerance of a triangulated shape, in the picture only.
_SHAPE_TOLERANCE_MM = 0.02


def rig_of(header: Header) -> Rig:
    """The configuration's rig, or the simulated sensor's, which is the default."""
    config = header.config
    return Scene().replace(rig=config["rig"]).rig if "rig" in config else Scene().rig


def mesh_of(header: Header) -> tuple[Floats, Triangles] | None:
    """Vertices (object frame, millimetres) and triangles of the part, if it is recorded."""
    shape = header.config.get("part", {}).get("shape")
    if shape is None:
        return None
    if shape["kind"] != "mesh":
        return shape_mesh(shape, _SHAPE_TOLERANCE_MM)
    name = Path(shape["path"]).name
    for attached, data in header.attachments.items():
        if Path(attached).name == name:
            return _attached_mesh(data, name, shape["units"])
    return None


def _attached_mesh(data: bytes, name: str, units: Any) -> tuple[Floats, Triangles]:
    from io import BytesIO

    with needs(__name__):
        import trimesh

    from gelstereo.templates import load_mesh

    kind = Path(name).suffix.lstrip(".")
    return load_mesh(trimesh.load(BytesIO(data), file_type=kind, force="mesh"), units)
