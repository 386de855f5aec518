"""Recordings of a real sensor: contacts, radii, and templates registered to them.

Run ``python -m gelstereo.reports.recordings`` to fill docs/real-recordings.md and draw its picture; it needs the
recordings of the wheel pytac3d (``pip install --no-deps pytac3d==3.3.0.9``) and the extra ``bench``.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Localization, Params, Template, localize
from gelstereo.geometry import nearest
from gelstereo.recordings import (
    CloudRecording,
    Contact,
    contacts,
    episodes,
    fit_cylinder,
    fit_sphere,
    load_pytac3d,
    pytac3d_example,
)
from gelstereo.reports.markdown import replace_between, table

__all__ = ["PARTS", "Part", "Registered", "main", "register_part", "touching"]

Array = npt.NDArray[np.float64]

SALIENCY_MM = float(Params().to_dict()["contact"]["saliency_mm"])
#: Fewer markers than this do not determine a radius.
_MIN_CORE = 8


@dataclass(frozen=True)
class Part:
    """Something that was pressed into the sensor of example_1."""

    name: str
    #: Which run of touched frames, and which of its contacts, the deepest first.
    episode: int
    contact: int
    #: Radius of the template, mm; `None` where there is none.
    radius_mm: float | None
    #: Directions that the contact cannot determine.
    free: int

    def template(self) -> Template:
        """Make the template; nobody wrote down the part's dimensions, so its radius is the median of the fits."""
        if self.name == "plane":
            mesh = trimesh.creation.box((40.0, 40.0, 2.0))
        elif self.name == "cylinder":
            mesh = trimesh.creation.cylinder(self.radius_mm, 40.0, sections=256)
        else:
            mesh = trimesh.creation.icosphere(5, self.radius_mm)
        return Template.from_mesh(mesh, units="mm", spacing_mm=0.25)

    def guess(self, points_mm: Array) -> Array:
        """Guess a pose: the part lies on the patch, a cylinder along its longer side."""
        pose = np.eye(4)
        pose[:3, 3] = points_mm.mean(axis=0)
        pose[2, 3] += 1.0 if self.radius_mm is None else self.radius_mm  # the plane's template is 2 mm thick
        if self.name == "cylinder":
            axis = np.linalg.svd(points_mm - points_mm.mean(axis=0), full_matrices=False)[2][0]
            across = np.cross([0.0, 0.0, 1.0], axis)
            across /= np.linalg.norm(across)
            pose[:3, :3] = np.column_stack([across, np.cross(axis, across), axis])
        return pose

    def fitted_radius_mm(self, points_mm: Array) -> float | None:
        """Fit the radius to one frame's points."""
        if self.radius_mm is None:
            return None
        if self.name == "cylinder":
            return fit_cylinder(points_mm).radius_mm
        return fit_sphere(points_mm).radius_mm


PARTS = (
    Part("small ball", 0, 0, 4.44, 3),
    Part("large ball", 0, 1, 10.04, 3),
    Part("cylinder", 1, 0, 4.57, 2),
    Part("plane", 2, 0, None, 3),
)


@dataclass(frozen=True)
class Registered:
    """One frame of one part."""

    frame: int
    points_mm: Array
    depth_mm: float
    radius_mm: float | None
    result: Localization
    #: Root mean square distance of all points from the template, along its normals. It is worked out here because
    #: `Localization.rmse_mm` weighs each point by how likely it touches, which hides those that do not.
    residual_mm: float


def touching(recording: CloudRecording) -> list[list[Contact]]:
    """Find the contacts of every frame."""
    return [
        contacts(indentation, recording.rows, recording.cols, SALIENCY_MM)
        for indentation in recording.indentation_mm()
    ]


def register_part(
    recording: CloudRecording, part: Part, method: str = "filterreg_plane", every: int = 1
) -> list[Registered]:
    """Register a part's template to its episode, every so many frames.

    Frames in which fewer than eight markers touch, or in which the part is not there, are left out.
    """
    found = touching(recording)
    runs = episodes(recording.indentation_mm(), SALIENCY_MM)
    together = 1 + max(p.contact for p in PARTS if p.episode == part.episode)
    template, params = part.template(), Params().replace({"register": {"method": method}})
    registered = []
    for frame in list(runs[part.episode])[::every]:
        if len(found[frame]) < together or len(found[frame][part.contact].core) < _MIN_CORE:
            continue
        contact = found[frame][part.contact]
        points_mm = recording.points_mm[frame][contact.core]
        result = localize(points_mm, template, t_sensor_object=part.guess(points_mm), params=params)
        radius_mm = part.fitted_radius_mm(points_mm)
        residual_mm = _residual_mm(points_mm, template, result.t_sensor_object)
        registered.append(Registered(frame, points_mm, contact.depth_mm, radius_mm, result, residual_mm))
    return registered


def _residual_mm(points_mm: Array, template: Template, t_sensor_object: Array) -> float:
    in_object = (points_mm - t_sensor_object[:3, 3]) @ t_sensor_object[:3, :3]
    indices, _ = nearest(template.points_mm, in_object)
    along = np.sum((in_object - template.points_mm[indices]) * template.normals[indices], axis=1)
    return float(np.sqrt(np.mean(along**2)))


def main(arguments: list[str] | None = None) -> int:
    """Fill docs/real-recordings.md and draw its picture."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo.reports.recordings", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    parts: dict[str, list[Registered]] = {}
    residuals = []
    for part in PARTS:
        print(part.name)
        parts[part.name] = register_part(recording, part)
        paper = register_part(recording, part, "filterreg_point", every=5)
        residuals.append(_row(part, parts[part.name], paper))
    head = ["part", "frames", "markers", "radius mm", "spread mm", "residual um", "paper's rung um", "free"]
    page = options.docs / "real-recordings.md"
    replace_between(page, "episodes", _episodes(recording))
    replace_between(page, "parts", table(head, residuals))
    _draw(recording, parts, options.docs / "pictures" / "real-recordings.png")
    return 0


def _row(part: Part, frames: list[Registered], paper: list[Registered]) -> list[str]:
    radii = np.array([f.radius_mm for f in frames if f.radius_mm is not None])
    residual_um = 1e3 * np.array([f.residual_mm for f in frames])
    paper_um = 1e3 * np.median([f.residual_mm for f in paper])
    free = sorted({len(f.result.free) for f in frames})
    return [
        part.name,
        str(len(frames)),
        f"{np.median([len(f.points_mm) for f in frames]):.0f}",
        f"{np.median(radii):.2f}" if len(radii) else "-",
        f"{np.std(radii):.2f} ({radii.min():.2f} to {radii.max():.2f})" if len(radii) else "-",
        f"{np.median(residual_um):.1f} (at most {residual_um.max():.1f})",
        f"{paper_um:.1f}",
        ", ".join(map(str, free)),
    ]


def _episodes(recording: CloudRecording) -> str:
    indentation = recording.indentation_mm()
    salient = (indentation > SALIENCY_MM).sum(axis=1)
    rows = []
    for run in episodes(indentation, SALIENCY_MM):
        deepest = indentation[run.start : run.stop].max()
        counts = salient[run.start : run.stop]
        rows.append([f"{run.start} to {run.stop - 1}", f"{np.median(counts):.0f}", f"{deepest:.2f}"])
    touched = sum(int(row[0].split()[2]) - int(row[0].split()[0]) + 1 for row in rows)
    rows.append(
        [
            f"the other {len(recording) - touched}",
            "0",
            f"{indentation[salient == 0].max():.2f} (below threshold)",
        ]
    )
    return table(["frames", "salient markers (median)", "deepest mm"], rows)


def _draw(recording: CloudRecording, parts: dict[str, list[Registered]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(15, 4.4), layout="constrained")
    indentation = recording.indentation_mm()
    frame = 44
    rest = recording.rest_mm
    dots = axes[0].scatter(rest[:, 0], rest[:, 1], c=indentation[frame], s=42, cmap="viridis")
    figure.colorbar(dots, ax=axes[0], label="indentation, mm")
    for name, colour in (("small ball", "red"), ("large ball", "orange")):
        shown = next(f for f in parts[name] if f.frame == frame)
        x, y, _ = shown.points_mm.T
        axes[0].scatter(
            x, y, s=90, facecolors="none", edgecolors=colour, label=f"{name}: r = {shown.radius_mm:.2f} mm"
        )
        centre = shown.result.t_sensor_object[:2, 3]
        axes[0].plot(*centre, "+", color=colour, markersize=14)
    axes[0].set(title=f"frame {frame}: markers, contacts, located centres", xlabel="x, mm", ylabel="y, mm")
    axes[0].set_aspect("equal")
    axes[0].legend(loc="lower left", fontsize=8)
    for name, frames in parts.items():
        where = [f.frame for f in frames]
        if frames[0].radius_mm is not None:
            axes[1].plot(where, [f.radius_mm for f in frames], ".-", label=name)
        axes[2].plot(where, [1e3 * f.residual_mm for f in frames], ".-", label=name)
    axes[1].set(title="radius fitted to each frame", xlabel="frame", ylabel="mm", ylim=(0, 16))
    axes[2].set(title="residual of the registered template", xlabel="frame", ylabel="um rms", ylim=(0, None))
    for axis in axes[1:]:
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    raise SystemExit(main())
