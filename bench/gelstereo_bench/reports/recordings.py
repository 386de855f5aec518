"""Recordings of a real sensor: contacts, radii, registration of templates, and scatter of the poses.

Run ``python -m gelstereo_bench.reports.recordings`` to fill docs/real-recordings.md and draw its pictures; it
needs the recordings of the wheel pytac3d (``pip install --no-deps pytac3d==3.3.0.9``).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Localization, Params, Template, localize
from gelstereo.extras import needs
from gelstereo.geometry import nearest
from gelstereo.recordings import (
    CloudRecording,
    Contact,
    contacts,
    episodes,
    load_pytac3d,
    pytac3d_example,
)
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.radii import (
    Measured,
    Sharpened,
    draw_radii,
    measure_radii,
    radii_table,
    sharpen,
    vendor_radii_mm,
)
from gelstereo_bench.reports.steadiness import (
    Steadiness,
    rest_noise_mm,
    scatter_by_noise,
    scatter_over_time,
    stillest,
)

__all__ = ["PARTS", "Part", "Registered", "main", "measure_part", "register_part", "steadiness", "touching"]

Array = npt.NDArray[np.float64]

SALIENCY_MM = float(Params().to_dict()["contact"]["saliency_mm"])
#: Minimum number of markers for a radius.
_MIN_CORE = 8
#: Number of frames in a stretch with little motion.
_STILL = 8
_METHOD = "surface_search"


@dataclass(frozen=True)
class Part:
    """A part that was pressed into the sensor in example_1."""

    name: str
    #: Index of the run of frames with contact, and of the contact in it, the deepest first.
    episode: int
    contact: int
    #: Radius of the template, mm; `None` for a plane.
    radius_mm: float | None
    #: Directions that the contact cannot determine.
    free: int

    @property
    def together(self) -> int:
        """Number of parts pressed at the same time."""
        return 1 + max(part.contact for part in PARTS if part.episode == self.episode)

    def template(self) -> Template:
        """Create the template. The part's dimensions are not documented, so its radius is the joint one."""
        if self.name == "plane":
            mesh = trimesh.creation.box((40.0, 40.0, 2.0))
        elif self.name == "cylinder":
            mesh = trimesh.creation.cylinder(self.radius_mm, 40.0, sections=256)
        else:
            mesh = trimesh.creation.icosphere(5, self.radius_mm)
        return Template.from_mesh(mesh, units="mm", spacing_mm=0.25)

    def guess(self, points_mm: Array) -> Array:
        """Initial guess: the part lies on the patch, a cylinder along the patch's longer side."""
        pose = np.eye(4)
        pose[:3, 3] = points_mm.mean(axis=0)
        pose[2, 3] += 1.0 if self.radius_mm is None else self.radius_mm  # the plane's template is 2 mm thick
        if self.name == "cylinder":
            axis = np.linalg.svd(points_mm - points_mm.mean(axis=0), full_matrices=False)[2][0]
            across = np.cross([0.0, 0.0, 1.0], axis)
            across /= np.linalg.norm(across)
            pose[:3, :3] = np.column_stack([across, np.cross(axis, across), axis])
        return pose


PARTS = (
    Part("small ball", 0, 0, 4.29, 3),
    Part("large ball", 0, 1, 9.20, 3),
    Part("cylinder", 1, 0, 3.54, 2),
    Part("plane", 2, 0, None, 3),
)


@dataclass(frozen=True)
class Registered:
    """One frame of one part."""

    frame: int
    points_mm: Array
    depth_mm: float
    result: Localization
    #: Rms distance of all points from the template, along its normals. It is computed here because
    #: `Localization.rmse_mm` weights each point by its contact probability, which hides points that do not
    #: touch.
    residual_mm: float


def touching(recording: CloudRecording) -> list[list[Contact]]:
    """Contacts of every frame."""
    return [
        contacts(indentation, recording.rows, recording.cols, SALIENCY_MM)
        for indentation in recording.indentation_mm()
    ]


def register_part(
    recording: CloudRecording,
    part: Part,
    method: str = _METHOD,
    every: int = 1,
    *,
    whole: npt.NDArray[np.bool_] | None = None,
) -> list[Registered]:
    """Register a part's template to its episode, in every nth frame.

    Frames with fewer than eight markers in contact, without the part, or not ``whole``, are left out.
    """
    found = touching(recording)
    runs = episodes(recording.indentation_mm(), SALIENCY_MM)
    template, params = part.template(), Params().replace({"register": {"method": method}})
    registered = []
    for frame in list(runs[part.episode])[::every]:
        if whole is not None and not whole[frame]:
            continue
        if len(found[frame]) < part.together or len(found[frame][part.contact].core) < _MIN_CORE:
            continue
        contact = found[frame][part.contact]
        points_mm = recording.points_mm[frame][contact.core]
        result = localize(points_mm, template, guess=part.guess(points_mm), params=params)
        residual_mm = _residual_mm(points_mm, template, result.t_sensor_object)
        registered.append(Registered(frame, points_mm, contact.depth_mm, result, residual_mm))
    return registered


def _residual_mm(points_mm: Array, template: Template, t_sensor_object: Array) -> float:
    in_object = (points_mm - t_sensor_object[:3, 3]) @ t_sensor_object[:3, :3]
    indices, _ = nearest(template.points_mm, in_object)
    along = np.sum((in_object - template.points_mm[indices]) * template.normals[indices], axis=1)
    return float(np.sqrt(np.mean(along**2)))


def measure_part(sharpened: Sharpened, part: Part) -> Measured:
    """Radius of a ball or of the cylinder over its episode."""
    shape: Literal["sphere", "cylinder"] = "cylinder" if part.name == "cylinder" else "sphere"
    return measure_radii(sharpened, shape, (part.episode, part.contact, part.together), SALIENCY_MM)


def steadiness(sharpened: Sharpened, part: Part) -> tuple[Steadiness, Steadiness, float]:
    """Scatter of a part's pose from the noise at rest, and over its frames with least motion; and that
    motion, mm.
    """
    recording = sharpened.smooth
    found = touching(recording)
    frames = [
        frame
        for frame in episodes(recording.indentation_mm(), SALIENCY_MM)[part.episode]
        if len(found[frame]) >= part.together and sharpened.whole[frame]
    ]
    cores = {frame: found[frame][part.contact].core for frame in frames}
    points, core, motion_mm = stillest(recording.points_mm, cores, _STILL)
    noise = np.concatenate(
        [rest_noise_mm(stretch_mm[:, core], sharpened.window) for stretch_mm in sharpened.still_mm]
    )
    sigma_mm = float(np.sqrt(np.mean(noise[:, :, 2] ** 2)))
    template, guess = part.template(), part.guess(points[0])
    by_noise = scatter_by_noise(points[0], template, guess, list(noise), sigma_mm, _METHOD)
    over_time = scatter_over_time(points, template, guess, sharpened.window, sigma_mm, _METHOD)
    return by_noise, over_time, motion_mm


def main(arguments: list[str] | None = None) -> int:
    """Fill docs/real-recordings.md and draw its pictures."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.recordings", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    page, pictures = options.docs / "real-recordings.md", options.docs / "pictures"
    folder = pytac3d_example("example_1", "AD2-0065L")
    recording = load_pytac3d(folder)
    sharpened = sharpen(recording, SALIENCY_MM)
    replace_between(page, "episodes", _episodes(recording))
    replace_between(page, "smoothing", _smoothing(sharpened))
    measured = {part.name: measure_part(sharpened, part) for part in PARTS if part.radius_mm is not None}
    vendor = _vendor(recording, folder)
    replace_between(page, "radii", radii_table(measured, vendor))
    draw_radii(measured, vendor, pictures / "real-radii.png")
    parts: dict[str, list[Registered]] = {}
    residuals, steady = [], []
    for part in PARTS:
        print(part.name)
        parts[part.name] = register_part(sharpened.sharp, part, whole=sharpened.whole)
        paper = register_part(sharpened.sharp, part, "filterreg_point", 5, whole=sharpened.whole)
        residuals.append(_row(part, parts[part.name], paper))
        steady.append(_steady_row(part, *steadiness(sharpened, part)))
    head = ["part", "frames", "markers", "residual um", "paper's method um", "free"]
    replace_between(page, "parts", table(head, residuals))
    head = [
        "part",
        "ratio by noise",
        "height um",
        "predicted um",
        "moved um a frame",
        "ratio over time",
        "height um",
    ]
    replace_between(page, "steadiness", table(head, steady))
    _draw(sharpened.sharp, parts, pictures / "real-recordings.png")
    return 0


def _vendor(recording: CloudRecording, folder: Path) -> dict[str, dict[int, float]]:
    """The vendor's radii of the parts, in frames where it finds the right number of parts."""
    balls = {f: radii for f, radii in vendor_radii_mm(recording, folder, "sphere").items() if len(radii) == 2}
    cylinders = vendor_radii_mm(recording, folder, "cylinder")
    return {
        "small ball": {frame: radii[0] for frame, radii in balls.items()},
        "large ball": {frame: radii[1] for frame, radii in balls.items()},
        "cylinder": {frame: radii[0] for frame, radii in cylinders.items() if len(radii) == 1},
    }


def _smoothing(sharpened: Sharpened) -> str:
    x, y, z = 1e3 * sharpened.noise_mm
    lost = np.flatnonzero(sharpened.smooth.lost_before)
    return table(
        ["window, frames", "noise x um", "noise y um", "noise z um", "frames lost before"],
        [[str(sharpened.window), f"{x:.2f}", f"{y:.2f}", f"{z:.2f}", ", ".join(map(str, lost))]],
    )


def _steady_row(part: Part, by_noise: Steadiness, over_time: Steadiness, motion_mm: float) -> list[str]:
    return [
        part.name,
        f"{by_noise.ratio:.2f}",
        f"{by_noise.height_um:.2f}",
        f"{by_noise.height_predicted_um:.2f}",
        f"{1e3 * motion_mm:.0f}",
        f"{over_time.ratio:.0f}",
        f"{over_time.height_um:.1f}",
    ]


def _row(part: Part, frames: list[Registered], paper: list[Registered]) -> list[str]:
    residual_um = 1e3 * np.array([f.residual_mm for f in frames])
    paper_um = 1e3 * np.median([f.residual_mm for f in paper])
    free = sorted({len(f.result.free) for f in frames})
    return [
        part.name,
        str(len(frames)),
        f"{np.median([len(f.points_mm) for f in frames]):.0f}",
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
    with needs(__name__):
        import matplotlib

    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    indentation = recording.indentation_mm()
    frame = 44
    rest = recording.rest_mm
    dots = axes[0].scatter(rest[:, 0], rest[:, 1], c=indentation[frame], s=42, cmap="viridis")
    figure.colorbar(dots, ax=axes[0], label="indentation, mm")
    for name, colour in (("small ball", "red"), ("large ball", "orange")):
        shown = next(f for f in parts[name] if f.frame == frame)
        x, y, _ = shown.points_mm.T
        axes[0].scatter(x, y, s=90, facecolors="none", edgecolors=colour, label=name)
        centre = shown.result.t_sensor_object[:2, 3]
        axes[0].plot(*centre, "+", color=colour, markersize=14)
    axes[0].set(title=f"frame {frame}: markers, contacts, located centres", xlabel="x, mm", ylabel="y, mm")
    axes[0].set_aspect("equal")
    axes[0].legend(loc="lower left", fontsize=8)
    for name, frames in parts.items():
        where = [f.frame for f in frames]
        axes[1].plot(where, [1e3 * f.residual_mm for f in frames], ".-", label=name)
    axes[1].set(title="residual of the registered template", xlabel="frame", ylabel="um rms", ylim=(0, None))
    axes[1].grid(alpha=0.3)
    axes[1].legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    raise SystemExit(main())
