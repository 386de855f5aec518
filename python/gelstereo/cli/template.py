"""The command ``gelstereo template``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gelstereo import Surface, Symmetry, Template
from gelstereo.cli.files import write_image
from gelstereo.templates import MM_PER_UNIT, load_part

EXAMPLES = """examples:
  gelstereo template plug.stl --units m --output preview.png            what the mesh is, and a picture of it
  gelstereo template plug.stl --units m --save plug.template            to localize with, without the mesh
  gelstereo template scan.ply --units mm --output preview.png           points with outward normals

Faces that point inward are turned. Holes and symmetries are reported. STEP files contain their unit.
"""

#: Number of axes printed in full; a cube has thirteen.
_MAX_AXES = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("mesh", type=Path, help="mesh of the part: .stl, .ply, .obj, .glb, .step, ...")
    parser.add_argument("--units", choices=list(MM_PER_UNIT), help="unit of the mesh; STEP files say it")
    parser.add_argument(
        "--spacing-mm", type=float, default=0.25, help="distance of template points (%(default)s)"
    )
    parser.add_argument(
        "--tolerance-mm", type=float, default=0.02, help="how well a symmetry has to hold (%(default)s)"
    )
    parser.add_argument("--output", type=Path, metavar="PICTURE", help="picture to write (.png, ...)")
    parser.add_argument("--save", type=Path, metavar="FILE", help="template to write (.template)")


def run(arguments: argparse.Namespace) -> int:
    """Check the mesh, print its properties, and write the requested files; return the exit code."""
    from gelstereo.view.part import draw_scan, draw_template

    name = arguments.mesh.name
    vertices_mm, faces, spacing_mm = load_part(arguments.mesh, arguments.units, arguments.spacing_mm)
    size = " x ".join(f"{side:.4g}" for side in np.ptp(vertices_mm, axis=0))
    if spacing_mm is None:
        template = Template.from_triangles(vertices_mm, faces, spacing_mm=arguments.spacing_mm)
        template = template.with_symmetries(tolerance_mm=arguments.tolerance_mm)
        assert template.surface is not None  # it was created from triangles
        notes = [
            f"{size} mm, {len(faces)} triangles, {len(template)} points {template.spacing_mm:g} mm apart",
            _surface_in_words(template.surface),
            _symmetries_in_words(template.symmetries, arguments.tolerance_mm),
        ]
    else:
        template = Template.from_points(vertices_mm, faces, spacing_mm)
        notes = [
            f"{size} mm, a scan without triangles, {len(template)} points {spacing_mm:.3g} mm apart",
            "distances are those to its points; symmetries can be declared",
        ]
    print("\n".join([f"{name}: {notes[0]}", *notes[1:]]))
    if arguments.output is not None:
        if spacing_mm is None:
            triangles = np.asarray(faces, dtype=np.int64)
            picture = draw_template(vertices_mm, triangles, name, notes, template.symmetries)
        else:
            picture = draw_scan(template.points_mm, template.normals, spacing_mm, name, notes)
        write_image(arguments.output, picture)
        print(f"wrote {arguments.output}")
    if arguments.save is not None:
        template.save(arguments.save)
        print(f"wrote {arguments.save}")
    return 0


def _surface_in_words(surface: Surface) -> str:
    if not surface.is_closed:
        return f"open: {surface.boundary_edges} edges at holes, {surface.clashing_edges} where faces clash"
    return f"closed, volume {surface.volume_mm3:.4g} mm3"


def _symmetries_in_words(symmetries: tuple[Symmetry, ...], tolerance_mm: float) -> str:
    if not symmetries:
        return f"no symmetry to {tolerance_mm:g} mm"
    words = [
        f"{'any turn' if axis.order is None else f'{axis.order} turns'} about ({x:.3f}, {y:.3f}, {z:.3f})"
        for axis in symmetries[:_MAX_AXES]
        for x, y, z in [axis.axis + 0.0]
    ]
    more = len(symmetries) - len(words)
    return (
        f"same to {tolerance_mm:g} mm after " + ", ".join(words) + (f", and {more} more" if more > 0 else "")
    )
