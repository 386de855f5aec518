"""Meshes of parts, read with trimesh, in millimetres.

Mesh files do not say what their unit is, so whoever reads one has to; what cannot be the size of a part that a hand
holds is refused with a guess.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import MeshError, turned_outward

if TYPE_CHECKING:
    import trimesh

Units = Literal["mm", "cm", "m", "inch"]

MM_PER_UNIT: dict[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}

#: Largest extent of a part that a gripper can hold and a fingertip sensor can make sense of.
MIN_PART_MM, MAX_PART_MM = 1.0, 1000.0


#: Files that say what their unit is.
_STEP = {".step", ".stp"}


class MeshWarning(UserWarning):
    """A mesh has holes, or faces that were inside out and have been turned."""


def load_mesh(
    mesh: str | Path | trimesh.Trimesh, units: Units | None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices in millimetres and triangles of a mesh, facing outward.

    Parameters
    ----------
    mesh
        A file that trimesh reads (STL, OBJ, PLY, GLB, ..., or STEP with the extra ``gelstereo[step]``; the parts of a
        scene are joined), or a ``trimesh.Trimesh``.
    units
        What one unit of the file is: ``"mm"``, ``"cm"``, ``"m"`` or ``"inch"``; ``None`` for a STEP file, which says it
        itself.

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

    Warns
    -----
    MeshWarning
        If faces had to be turned, or the surface has holes; distances to it are exact all the same.
    """
    name = Path(mesh).name if isinstance(mesh, (str, Path)) else "the mesh"
    if Path(name).suffix.lower() in _STEP:
        if units is not None:
            raise MeshError(f"units is {units!r}; valid for a STEP file, which says its unit itself, is None")
        units = "m"
    elif not isinstance(units, str) or units not in MM_PER_UNIT:
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
    vertices_mm = vertices * MM_PER_UNIT[units]
    return vertices_mm, _facing_outward(vertices_mm, triangles, name)


def _facing_outward(
    vertices_mm: npt.NDArray[np.float64], triangles: npt.NDArray[np.int64], name: str
) -> npt.NDArray[np.int64]:
    """Turn triangles that are inside out, and tell of that and of holes."""
    turned, stray, inside_out, surface = turned_outward(vertices_mm, triangles)
    told = []
    if inside_out:
        told.append("its faces were inside out and have been turned")
    if stray:
        told.append(f"{stray} of {len(triangles)} triangles faced the wrong way and have been turned")
    if surface.boundary_edges:
        told.append(
            f"it has holes ({surface.boundary_edges} edges with a triangle on one side alone): distances are exact, "
            "but inside and outside are told apart near its faces only"
        )
    if told:
        warnings.warn(f"{name}: {'; '.join(told)}", MeshWarning, stacklevel=3)
    return turned


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
    except FileNotFoundError as error:
        # The file is there; what is missing is what a STEP file should have been converted to.
        raise MeshError(f"{path} cannot be read as a triangle mesh: it is no whole STEP file") from error
    except ImportError as error:
        # trimesh asks for other packages when it meets a format that it cannot read alone, or text that is none.
        extra = "; pip install 'gelstereo[step]'" if path.suffix.lower() in _STEP else ""
        raise MeshError(
            f"{path} cannot be read as a triangle mesh without another package ({error}); valid is "
            f"a whole STL, OBJ or PLY file{extra}"
        ) from error
    except (ValueError, KeyError, IndexError, AttributeError, TypeError, NotImplementedError) as error:
        raise MeshError(f"{path} cannot be read as a triangle mesh: {error}") from error
