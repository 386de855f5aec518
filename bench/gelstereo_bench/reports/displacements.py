"""Displacements between rest and press frames of a real gel, through the whole pipeline.

The recordings of the wheel pytac3d are clouds without images. Their markers are rendered through a simulated
stereo rig. Detection, labelling, tracking and triangulation run on the images, and the result is compared
with the recording.

Run ``python -m gelstereo_bench.reports.displacements`` to fill docs/real-recordings.md and draw its picture;
it needs the wheel (``pip install --no-deps pytac3d==3.3.0.9``).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import MarkerState, Params, Pipeline, Scene, Simulator
from gelstereo.extras import needs
from gelstereo.recordings import CloudRecording, episodes, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["EPISODES", "Replay", "main", "replay"]

Array = npt.NDArray[np.float64]

EPISODES = ("two balls", "cylinder", "plane")
SALIENCY_MM = float(Params().to_dict()["contact"]["saliency_mm"])
#: Offset that places the recorded gel in the view of both cameras of the default rig.
_SHIFT_MM = np.array([4.5, 0.6, 17.25])
_EFFECTS: dict[str, dict[str, float]] = {"sensor_noise": {}, "grain": {}, "uneven_light": {}, "defocus": {}}


@dataclass(frozen=True)
class Replay:
    """Results of the pipeline for a recording's markers; M markers, F frames."""

    #: The recording with its markers in row-major order of the images.
    recording: CloudRecording
    #: (M, 2) and (F, M, 2), left and right image, pixels.
    rest_px: tuple[Array, Array]
    press_px: tuple[Array, Array]
    #: (F, M, 2) true positions of the markers in the left image.
    true_px: Array
    #: (F, M, 3) measured displacements from rest, millimetres, sensor frame.
    displacement_mm: Array
    #: (F, M, 3, 3) covariances stated by the pipeline.
    covariance_mm2: Array
    #: (F, M) mask of the markers seen in both views.
    seen: npt.NDArray[np.bool_]
    #: (H, W) left images of the requested frames.
    images: dict[int, npt.NDArray[np.uint8]]

    @property
    def recorded_mm(self) -> Array:
        """Displacements (F, M, 3) of the recording."""
        return self.recording.points_mm - self.recording.rest_mm

    def switched(self) -> npt.NDArray[np.int64]:
        """Number of markers, per frame (F,), that are nearer to another marker's true position than to their
        own.
        """
        counts = []
        for found_px, true_px in zip(self.press_px[0], self.true_px, strict=True):
            apart = ((found_px[:, None] - true_px[None]) ** 2).sum(axis=2)
            counts.append(int((apart.argmin(axis=1) != np.arange(len(apart))).sum()))
        return np.array(counts)

    def nees(self) -> Array:
        """Squared error (F, M) of every displacement, normalised by its covariance; 3 on average if that is
        right.
        """
        error = self.displacement_mm - self.recorded_mm
        return np.asarray(
            np.einsum("fmi,fmi->fm", error, np.linalg.solve(self.covariance_mm2, error[..., None])[..., 0])
        )


def replay(recording: CloudRecording, preset: str = "balanced", keep: tuple[int, ...] = ()) -> Replay:
    """Render a recording's markers and run the pipeline over the images, its rest frame first.

    Parameters
    ----------
    recording
        Point clouds in PyTac3D's order and frame.
    preset
        The pipeline's settings; only the pitch is set.
    keep
        Frames whose left images are kept.
    """
    # PyTac3D counts rows and columns from the opposite corner, against x and y of the image.
    points_mm, rest_mm = recording.points_mm[:, ::-1], recording.rest_mm[::-1]
    recording = CloudRecording(
        recording.name, recording.rows, recording.cols, points_mm, rest_mm, recording.time_s
    )
    scene = Scene().replace(
        gel={"rows": recording.rows, "cols": recording.cols, "pitch_mm": 1.0, "dot_radius_mm": 0.25},
        effects=_EFFECTS,
    )
    params = Params.preset(preset).replace(lattice={"pitch_mm": 1.0})
    simulator, pipeline = Simulator(scene), Pipeline(scene.rig, params)
    rendered = simulator.render_points(rest_mm + _SHIFT_MM)
    rest = pipeline.process(rendered.left, rendered.right)
    frames, true_px, images = [], [], {}
    for index, cloud_mm in enumerate(points_mm):
        rendered = simulator.render_points(cloud_mm + _SHIFT_MM, frame=index + 1)
        frames.append(pipeline.process(rendered.left, rendered.right))
        true_px.append(rendered.left_px)
        if index in keep:
            images[index] = rendered.left
    return Replay(
        recording,
        (rest.left_px, rest.right_px),
        (np.array([f.left_px for f in frames]), np.array([f.right_px for f in frames])),
        np.array(true_px),
        np.array([f.points_mm for f in frames]) - rest.points_mm,
        np.array([f.covariance_mm2 for f in frames]) + rest.covariance_mm2,
        np.array([f.state == MarkerState.SEEN for f in frames]),
        images,
    )


def main(arguments: list[str] | None = None) -> int:
    """Fill the section on displacements of docs/real-recordings.md and draw its picture."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.reports.displacements", description=__doc__
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    indentation = recording.indentation_mm()
    runs = episodes(indentation, SALIENCY_MM)
    deepest = tuple(run.start + int(indentation[run.start : run.stop].max(axis=1).argmax()) for run in runs)
    replays = {preset: replay(recording, preset, deepest) for preset in ("balanced", "exact")}
    touched = np.concatenate([np.arange(run.start, run.stop) for run in runs])
    parts = [
        *((name, np.arange(run.start, run.stop)) for name, run in zip(EPISODES, runs, strict=True)),
        ("no touch", np.setdiff1d(np.arange(len(recording)), touched)),
    ]
    rows = [_row(preset, r, name, frames) for preset, r in replays.items() for name, frames in parts]
    head = [
        "preset",
        "part",
        "frames",
        "seen %",
        "switched",
        "largest um",
        "rms xy um",
        "rms z um",
        "predicted xy um",
    ]
    replace_between(
        options.docs / "real-recordings.md",
        "displacements",
        table([*head, "predicted z um", "largest error um", "NEES / 3"], rows),
    )
    _draw(replays["balanced"], deepest, options.docs / "pictures" / "real-displacements.png")
    return 0


def _row(preset: str, replayed: Replay, name: str, frames: npt.NDArray[np.int64]) -> list[str]:
    error_um = 1e3 * (replayed.displacement_mm - replayed.recorded_mm)[frames]
    predicted_um = 1e3 * np.sqrt(np.einsum("fmii->fmi", replayed.covariance_mm2[frames]).mean(axis=(0, 1)))
    rms_um = np.sqrt((error_um**2).mean(axis=(0, 1)))

    def in_plane(of: Array) -> float:
        return float(np.sqrt((of[:2] ** 2).mean()))

    return [
        preset,
        name,
        str(len(frames)),
        f"{100.0 * replayed.seen[frames].mean():.1f}",
        str(int(replayed.switched()[frames].sum())),
        f"{1e3 * np.linalg.norm(replayed.recorded_mm[frames], axis=2).max():.0f}",
        f"{in_plane(rms_um):.1f}",
        f"{rms_um[2]:.1f}",
        f"{in_plane(predicted_um):.1f}",
        f"{predicted_um[2]:.1f}",
        f"{np.linalg.norm(error_um, axis=2).max():.0f}",
        f"{replayed.nees()[frames].mean() / 3.0:.2f}",
    ]


def _draw(replayed: Replay, frames: tuple[int, ...], path: Path) -> None:
    with needs(__name__):
        import matplotlib

    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(16, 10), layout="compressed")
    rest_px, rest_mm = replayed.rest_px[0], replayed.recording.rest_mm
    for (above, below), frame, name in zip(axes.T, frames, EPISODES, strict=True):
        motion_px = replayed.press_px[0][frame] - rest_px
        above.imshow(replayed.images[frame], cmap="gray", vmin=0, vmax=255)
        doubled = {"angles": "xy", "scale_units": "xy", "scale": 0.5, "width": 0.006, "minlength": 0.0}
        above.quiver(*rest_px.T, *motion_px.T, color="tab:orange", **doubled)
        (left, top), (right, bottom) = rest_px.min(axis=0) - 15.0, rest_px.max(axis=0) + 15.0
        above.set(xlim=(left, right), ylim=(bottom, top))
        above.set_title(f"{name}, frame {frame}: left image, rest to press x 2")
        measured, recorded = replayed.displacement_mm[frame], replayed.recorded_mm[frame]
        colours = -1e3 * measured[:, 2]
        dots = below.scatter(*rest_mm[:, :2].T, c=colours, s=110, marker="s", cmap="Blues", linewidths=0)
        figure.colorbar(dots, ax=below, label="towards the camera, um", shrink=0.9)
        scaled = {"angles": "xy", "scale_units": "xy", "scale": 0.25, "minlength": 0.0}
        below.quiver(*rest_mm[:, :2].T, *recorded[:, :2].T, width=0.009, color="gold", **scaled)
        below.quiver(*rest_mm[:, :2].T, *measured[:, :2].T, width=0.003, color="black", **scaled)
        below.set(title="in the plane x 4: recorded gold, measured black", xlabel="x, mm", ylabel="y, mm")
        below.set_aspect("equal")
        below.invert_yaxis()
    figure.savefig(path, dpi=90, bbox_inches="tight")
    plt.close(figure)


if __name__ == "__main__":
    raise SystemExit(main())
