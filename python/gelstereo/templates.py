"""Meshes of parts, read with trimesh, in millimetres.

Most mesh files do not state their unit, so the caller must. A size that is impossible for a hand-held part is
rejected, with a guess of the right unit.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo._native import MeshError, turned_outward
from gelstereo.extras import needs
from gelstereo.point_files import PointFileError, check_ply

if TYPE_CHECKING:
    import trimesh

__all__ = ["MeshWarning", "check_size", "load_mesh", "load_part"]

Units = Literal["mm", "cm", "m", "inch"]
#: Input of `load_part`.
_Loaded: TypeAlias = "trimesh.Trimesh | trimesh.PointCloud"

MM_PER_UNIT: dict[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}

#: Largest extent of a part that a gripper can hold and a fingertip sensor can localize.
MIN_PART_MM, MAX_PART_MM = 1.0, 1000.0


#: Minimum number of points of a surface; also the number of points per cell from which density is estimated.
_MIN_POINTS = 6

#: File formats that can be read.
_WHOLE = "a complete STL, OBJ, PLY, GLB or STEP file"

#: File formats that state their unit.
_STEP = {".step", ".stp"}


class MeshWarning(UserWarning):
    """A mesh has holes, or inverted faces that were turned."""


def load_mesh(
    mesh: str | Path | trimesh.Trimesh, units: Units | None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices in millimetres and triangles of a mesh, facing outward.

    Parameters
    ----------
    mesh
        A file that trimesh reads (STL, OBJ, PLY, GLB, ..., or STEP with the extra ``gelstereo[step]``; the
        parts of a scene are joined), or a ``trimesh.Trimesh``.
    units
        Unit of the file: ``"mm"``, ``"cm"``, ``"m"`` or ``"inch"``; ``None`` for a STEP file, which states
        it.

    Returns
    -------
    vertices_mm : (V, 3) float64
        Vertices in the object frame.
    triangles : (F, 3) int64
        Indices of the corners, counter-clockwise seen from outside.

    Raises
    ------
    MeshError
        If the units are unknown, the file is not a triangle mesh, or its size is not that of a hand-held
        part.
    FileNotFoundError
        If there is no such file.

    Warns
    -----
    MeshWarning
        If faces had to be turned, or the surface has holes. Distances to it are exact nevertheless.
    """
    valid_units = _checked_units(mesh, units)
    return _surface(_opened(mesh), valid_units, _name(mesh, "the mesh"))


def _name(part: object, otherwise: str) -> str:
    return Path(part).name if isinstance(part, (str, Path)) else otherwise


def _checked_units(part: object, units: Units | None) -> Units:
    if Path(_name(part, "")).suffix.lower() in _STEP:
        if units is not None:
            raise MeshError(f"units is {units!r}; valid for a STEP file, which states its unit, is None")
        return "m"
    if not isinstance(units, str) or units not in MM_PER_UNIT:
        valid = ", ".join(f"'{name}'" for name in MM_PER_UNIT)
        raise MeshError(f"units is {units!r}; valid is one of {valid}")
    return units


def _opened(part: str | Path | _Loaded) -> _Loaded:
    return _read(Path(part)) if isinstance(part, (str, Path)) else part


def _surface(
    loaded: _Loaded, units: Units, name: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    if not (hasattr(loaded, "vertices") and hasattr(loaded, "faces")):
        raise MeshError(
            f"the mesh is of type {type(loaded).__name__}; valid is a file's path or a trimesh.Trimesh"
        )
    vertices = np.asarray(loaded.vertices, dtype=np.float64)
    triangles = np.asarray(loaded.faces, dtype=np.int64)
    if vertices.size == 0 or triangles.size == 0:
        raise MeshError(f"{name} cannot be read as a triangle mesh: it has no triangles; valid is {_WHOLE}")
    _check_finite(vertices, name)
    check_size(vertices.max(axis=0) - vertices.min(axis=0), units)
    vertices_mm = vertices * MM_PER_UNIT[units]
    return vertices_mm, _facing_outward(vertices_mm, triangles, name)


def load_part(
    part: str | Path | trimesh.Trimesh | trimesh.PointCloud, units: Units | None, spacing_mm: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64] | npt.NDArray[np.float64], float | None]:
    """Load the data of a template: a mesh, or a scan's points if there are no triangles.

    Parameters
    ----------
    part, units
        As in `load_mesh`; or a PLY file, or ``trimesh.PointCloud`` read from one, of points with outward
        normals (``nx``, ``ny``, ``nz``).
    spacing_mm
        Distance between neighbours to which a scan's points are thinned.

    Returns
    -------
    vertices_mm, triangles, None
        For a mesh, as returned by `load_mesh`.
    points_mm, normals, spacing_mm
        For a scan: (N, 3) points and normals, and the typical distance of neighbours, larger than requested
        if the scan is sparse.

    Raises
    ------
    MeshError
        As `load_mesh`; and for points without normals, or fewer than six.
    """
    valid_units, loaded = _checked_units(part, units), _opened(part)
    scan = _scan(part, loaded)
    if scan is None:
        return *_surface(loaded, valid_units, _name(part, "the mesh")), None
    name = _name(part, "the scan")
    points, normals = _points_and_normals(scan, name)
    _check_finite(points, name)
    check_size(np.ptp(points, axis=0), valid_units)
    points_mm = points * MM_PER_UNIT[valid_units]
    if np.einsum("ni,ni->", points_mm - points_mm.mean(axis=0), normals) < 0.0:
        warnings.warn(f"{name}: its normals look inward; valid are outward ones", MeshWarning, stacklevel=2)
    return _thinned(points_mm, normals, spacing_mm)


def _scan(part: str | Path | _Loaded, loaded: _Loaded) -> trimesh.PointCloud | None:
    """The points of a part without triangles. Read as a mesh, a file of points is empty."""
    if len(getattr(loaded, "faces", ())):
        return None
    with needs(__name__):
        import trimesh

    again = trimesh.load(part, process=False) if isinstance(part, (str, Path)) else loaded
    return again if len(getattr(again, "vertices", ())) else None


def _points_and_normals(
    cloud: trimesh.PointCloud, name: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    points = np.asarray(cloud.vertices, np.float64)
    vertex = cloud.metadata.get("_ply_raw", {}).get("vertex", {})
    if len(points) < _MIN_POINTS:
        raise MeshError(
            f"{name} has no triangles and {len(points)} points; valid are {_MIN_POINTS} points or more"
        )
    if not {"nx", "ny", "nz"} <= set(vertex.get("properties", ())):
        raise MeshError(
            f"{name} has no triangles, and its {len(points)} points have no normals; valid is a mesh, or "
            "points with outward normals (nx, ny, nz) in a PLY file"
        )
    data = vertex["data"]
    normals = np.column_stack([np.asarray(data[axis], np.float64).ravel() for axis in ("nx", "ny", "nz")])
    return points, normals


def _thinned(
    points_mm: npt.NDArray[np.float64], normals: npt.NDArray[np.float64], spacing_mm: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], float]:
    """Points thinned to about the requested distance, and their actual distance.

    On average over its directions, a surface crosses 3/2 grid cells per area of a cell's face (Crofton).
    """
    if not (np.isfinite(spacing_mm) and spacing_mm > 0.0):
        return points_mm, normals, spacing_mm
    cell_mm = spacing_mm
    while (share := len(points_mm) / len(_first_of_cells(points_mm, cell_mm))) < _MIN_POINTS:
        cell_mm *= 1.5
    found_mm = cell_mm / np.sqrt(1.5 * share)
    if found_mm >= spacing_mm:
        return points_mm, normals, float(found_mm)
    keep = _first_of_cells(points_mm, np.sqrt(1.5) * spacing_mm)
    return points_mm[keep], normals[keep], spacing_mm


def _first_of_cells(points_mm: npt.NDArray[np.float64], cell_mm: float) -> npt.NDArray[np.int64]:
    """The first point of every occupied cell, in the order of the points."""
    cells = np.floor((points_mm - points_mm.min(axis=0)) / cell_mm).astype(np.int64)
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])


def _facing_outward(
    vertices_mm: npt.NDArray[np.float64], triangles: npt.NDArray[np.int64], name: str
) -> npt.NDArray[np.int64]:
    """Turn inverted triangles; warn about these and about holes."""
    turned, stray, inside_out, surface = turned_outward(vertices_mm, triangles)
    told = []
    if inside_out:
        told.append("its faces were inside out and have been turned")
    if stray:
        told.append(f"{stray} of {len(triangles)} triangles faced the wrong way and have been turned")
    if surface.boundary_edges:
        told.append(
            f"it has holes ({surface.boundary_edges} edges with a triangle on one side alone): distances are "
            "exact, but inside and outside are distinguished only near its faces"
        )
    if told:
        warnings.warn(f"{name}: {'; '.join(told)}", MeshWarning, stacklevel=4)
    return turned


def _check_finite(points: npt.NDArray[np.float64], name: str) -> None:
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        x, y, z = points[bad[0]]
        raise MeshError(
            f"{bad.size} of {len(points)} vertices of {name} are not finite, vertex {bad[0]} first "
            f"({x:g}, {y:g}, {z:g}); valid are numbers"
        )


def check_size(extents: npt.NDArray[np.float64], units: Units) -> None:
    """Reject extents, in the stated units, that are impossible for a hand-held part.

    Raises
    ------
    MeshError
        With the extents, and units that would be plausible.
    """
    size = float(np.max(extents)) if np.all(np.isfinite(extents)) else float("nan")
    if MIN_PART_MM <= size * MM_PER_UNIT[units] <= MAX_PART_MM:
        return
    guesses = [name for name, mm in MM_PER_UNIT.items() if MIN_PART_MM <= size * mm <= MAX_PART_MM]
    # Millimetres and metres are by far the most common units.
    guesses.sort(key=["mm", "m", "inch", "cm"].index)
    text = " x ".join(f"{side:.4g}" for side in extents)
    hint = (
        f"; was it written in another unit? try units='{guesses[0]}'"
        if guesses
        else "; no unit gives such a size: scale the mesh"
    )
    raise MeshError(
        f"the extents are {text} {units}; valid is a largest side of {MIN_PART_MM:g} to {MAX_PART_MM:g} mm, "
        f"for a hand-held part{hint}"
    )


def _read(path: Path) -> _Loaded:
    with needs(__name__):
        import trimesh

    if not path.is_file():
        raise FileNotFoundError(2, "No such mesh file", str(path))
    try:
        if path.suffix.lower() == ".ply":
            check_ply(path)
        return trimesh.load(path, force="mesh", process=False)
    except FileNotFoundError as error:
        # The file exists; the missing file is the intermediate one from the conversion of a STEP file.
        raise MeshError(
            f"{path} cannot be read as a triangle mesh: it is not a complete STEP file"
        ) from error
    except PointFileError as error:
        raise MeshError(f"{path} cannot be read as a triangle mesh: {error}; valid is {_WHOLE}") from error
    except ImportError as error:
        # trimesh requests other packages for formats that it cannot read itself, and for invalid text.
        extra = "; pip install 'gelstereo[step]'" if path.suffix.lower() in _STEP else ""
        raise MeshError(
            f"{path} cannot be read as a triangle mesh without another package ({error}); valid is "
            f"{_WHOLE}{extra}"
        ) from error
    except (ValueError, LookupError, AttributeError, NameError, TypeError, NotImplementedError) as error:
        why = (
            str(error)
            if isinstance(error, (ValueError, NotImplementedError))
            else "it is truncated or damaged"
        )
        raise MeshError(f"{path} cannot be read as a triangle mesh: {why}; valid is {_WHOLE}") from error
