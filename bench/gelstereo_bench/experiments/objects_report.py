"""Report on the contact objects: the gallery of Fig. 12, compared with the truth."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import trimesh

from gelstereo.view.html import Block, Figure, Grid, Heading, Paragraph
from gelstereo.view.part import draw_template
from gelstereo_bench.experiments.batch import Trial
from gelstereo_bench.experiments.figures import as_svg, contact_maps
from gelstereo_bench.experiments.report import Report
from gelstereo_bench.experiments.store import Record
from gelstereo_bench.frontier.scenes import CONDITIONS

__all__ = ["TABLE", "objects_report", "summary_table"]

_ASKED = (
    "How well does the sensor measure and locate everyday objects? An M10 screw, a 3.5 mm connector, an SD "
    "card reader, a key, an irregular part and a USB drive are pressed into the gel (Fig. 12 of the paper, "
    "which shows the point clouds and images without figures). Here the ground truth is known: the height of "
    "every marker, which markers are in contact, and the object's pose. Poses and depths (0.8 to 1.4 mm) are "
    "random. The objects have common dimensions, since the paper states none."
)

#: Caption of the table of all contacts.
TABLE = "All contacts: heights, salient region and pose compared with the ground truth"


def objects_report(
    trials: Sequence[Trial],
    records: Sequence[Record],
    inputs: Mapping[str, str],
    meshes: Mapping[str, Callable[[], trimesh.Trimesh]],
) -> Report:
    """Create the table and the gallery from the records; `meshes` creates the objects by name."""
    summary = summary_table(trials, records)
    findings: list[Block] = [
        Heading("All contacts"),
        Paragraph(
            "Height: root mean square error over all markers. Precision and recall: salient markers compared "
            "with those in contact. Pose: from a guess up to 10 degrees and 2 mm off, over the directions "
            "that the contact determines. Tolerance: 2 degrees and 0.3 mm, the paper's clearance. A contact "
            "with a flat or round face leaves directions free; each result lists them."
        ),
        summary,
    ]
    for trial, record in zip(trials, records, strict=True):
        if "picture" in record:
            name = str(trial.configuration["object"])
            findings += _gallery(name, record, meshes[name]())
    return Report("Contact objects", _ASKED, CONDITIONS, findings, inputs, [summary])


def summary_table(trials: Sequence[Trial], records: Sequence[Record]) -> Grid:
    """One row for every object and method."""
    by_object: dict[str, list[Record]] = {}
    for trial, record in zip(trials, records, strict=True):
        by_object.setdefault(str(trial.configuration["object"]), []).append(record)
    rows = [
        [name, method, *_row([record["methods"][method] for record in found])]
        for name, found in by_object.items()
        for method in found[0]["methods"]
    ]
    every = [record for found in by_object.values() for record in found]
    rows += [["all", method, *_row([r["methods"][method] for r in every])] for method in every[0]["methods"]]
    head = ["object", "method", "height um", "precision %", "recall %", "within tolerance"]
    return Grid(TABLE, [*head, "median deg", "median mm", "refused"], rows)


def _row(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Figures of one method over some contacts."""
    located = [result for result in results if "refused" not in result]
    both, salient, touching = (sum(r[key] for r in results) for key in ("both", "salient", "touching"))
    squared = [result["height_um"] ** 2 for result in results if result["height_um"] is not None]
    return [
        f"{np.sqrt(np.mean(squared)):.1f}" if squared else "-",
        f"{100.0 * both / salient:.0f}" if salient else "-",
        f"{100.0 * both / touching:.0f}",
        f"{sum(r['within'] for r in located)} of {len(results)}",
        f"{np.median([r['angle_deg'] for r in located]):.2f}" if located else "-",
        f"{np.median([r['shift_mm'] for r in located]):.3f}" if located else "-",
        str(len(results) - len(located)),
    ]


def _gallery(name: str, record: Record, mesh: trimesh.Trimesh) -> list[Block]:
    """One object: alone, in the gel, and against the truth."""
    size = " x ".join(f"{length:.1f}" for length in mesh.extents)
    # Faces are drawn in order of the distance of their centres, which is correct only for small faces.
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 3.0)
    alone = draw_template(
        np.asarray(vertices),
        np.asarray(faces, np.int64),
        name,
        [f"{size} mm, {mesh.volume:.0f} mm3"],
    )
    done, picture = cv2.imencode(".png", alone, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done
    shape = (record["rows"], record["cols"])
    truth, found = (np.reshape(record[key], shape) for key in ("truth_mm", "found_mm"))
    touching, salient = (np.reshape(record[key], shape).astype(bool) for key in ("touching", "salient"))
    return [
        Heading(name),
        Figure(f"{name}: the object", picture.tobytes(), "png", width_px=320),
        Figure(
            f"{name}: left view with the markers' motion, heights, and the point cloud with salient points "
            "and the registered template (simulated)",
            base64.b64decode(record["picture"]),
            "jpeg",
        ),
        Figure(
            f"{name}: true and measured height of every marker, their difference, and the salient region "
            f"compared with the markers in contact; deepest marker {record['depth_mm']:.2f} mm (simulated)",
            as_svg(contact_maps(truth, found, touching, salient)),
            "svg",
        ),
    ]
