"""Meshes of parts, read with trimesh, in millimetres.

Mesh files do not say what their unit is, so whoever reads one has to; what cannot be the size of a part that a hand
holds is refused with a guess.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import MeshError

if TYPE_CHECKING:
    import trimesh

Units = Literal["mm", "cm", "m", "inch"]

MM_PER_UNIT: dict[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}

#: Largest extent of a part that a gripper can hold and a fingertip sensor can make sense of.
MIN_PART_MM, MAX_PART_MM = 1.0, 1000.0


def load_mesh(
    mesh: str | Path | trimesh.Trimesh, units: Units
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices in millimetres and triangles of a mesh.

    Parameters
    ----------
    mesh
        A file that trimesh reads (STL, OBJ, PLY, ...; the parts of a scene are joined), or a ``trimesh.Trimesh``.
    units
        What one unit of the file is: ``"mm"``, ``"cm"``, ``"m"`` or ``"inch"``.

    Returns
    -------
    vertices_mm : (V, 3) float64
        Vertices in the object frame.
    triangles : (F, 3) int64
        Indices of the corners, counter-clockwise seen from outside.

    Raises
    ------
    MeshError
        If the units are unknown, the file is no triangle mesh, or its size is not that of a hand-held part.
    FileNotFoundError
        If there is no such file.
    """
    if not isinstance(units, str) or units not in MM_PER_UNIT:
        valid = ", ".join(f"'{name}'" for name in MM_PER_UNIT)
        raise MeshError(f"units is {units!r}; valid is one of {valid}")
    loaded = _read(Path(mesh)) if isinstance(mesh, (str, Path)) else mesh
    if not (hasattr(loaded, "vertices") and hasattr(loaded, "faces")):
        raise MeshError(
            f"the mesh is of type {type(loaded).__name__}; valid is a file's path or a trimesh.Trimesh"
        )
    vertices = np.asarray(loaded.vertices, dtype=np.float64)
    triangles = np.asarray(loaded.faces, dtype=np.int64)
    if vertices.size == 0 or triangles.size == 0:
        raise MeshError("the mesh has no triangles; a surface needs at least one")
    extents = vertices.max(axis=0) - vertices.min(axis=0)
    check_size(extents, units)
    return vertices * MM_PER_UNIT[units], triangles


def check_size(extents: npt.NDArray[np.float64], units: Units) -> None:
    """Refuse extents, in the stated units, that no hand-held part has.

    Raises
    ------
    MeshError
        With the extents, and the units that would make sense of them.
    """
    size = float(np.max(extents)) if np.all(np.isfinite(extents)) else float("nan")
    if MIN_PART_MM <= size * MM_PER_UNIT[units] <= MAX_PART_MM:
        return
    guesses = [name for name, mm in MM_PER_UNIT.items() if MIN_PART_MM <= size * mm <= MAX_PART_MM]
    # A part's designer writes millimetres or metres far more often than the others.
    guesses.sort(key=["mm", "m", "inch", "cm"].index)
    text = " x ".join(f"{side:.4g}" for side in extents)
    hint = f"; was it written in another unit? try units='{guesses[0]}'" if guesses else ""
    raise MeshError(
        f"the extents are {text} {units}; valid is a largest side of {MIN_PART_MM:g} to {MAX_PART_MM:g} mm, "
        f"as a part in a hand has{hint}"
    )


def _read(path: Path) -> trimesh.Trimesh:
    import trimesh

    if not path.is_file():
        raise FileNotFoundError(2, "No such mesh file", str(path))
    try:
        return trimesh.load(path, force="mesh", process=False)
    except ImportError as error:
        # trimesh asks for other packages when it meets a format that it cannot read alone, or text that is none.
        raise MeshError(
            f"{path} cannot be read as a triangle mesh without another package ({error}); valid is "
            "a whole STL, OBJ or PLY file"
        ) from error
    except (ValueError, KeyError, IndexError, AttributeError, TypeError, NotImplementedError) as error:
        raise MeshError(f"{path} cannot be read as a triangle mesh: {error}") from error
