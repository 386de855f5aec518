"""Radii of the parts of a recording, frame by frame and over whole episodes, with their errors.

Part of ``python -m gelstereo_bench.reports.recordings``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs
from gelstereo.recordings import (
    CloudRecording,
    RadiusFit,
    contacts,
    episodes,
    fit_radius,
    intact,
    noise_gain,
    noise_mm,
    smoothing_frames,
    undo_smoothing,
)
from gelstereo_bench.reports.markdown import table

__all__ = [
    "Measured",
    "Sharpened",
    "draw_radii",
    "measure_radii",
    "radii_table",
    "sharpen",
    "vendor_radii_mm",
]

Array = npt.NDArray[np.float64]

#: Indentation thresholds of the core, relative to the deepest marker. The middle one is reported; the others
#: show its influence. At the edge of a Hertzian contact the ratio is 0.5.
SHARES = (0.5, 0.6, 0.7)
_MIN_CORE = 8
_BLOCKS = 5
#: Number of frames before and after an episode in which the gel still moves.
_MARGIN = 6
#: Width of the lattice's border that is excluded from the noise, markers.
_EDGE = 2


@dataclass(frozen=True)
class Sharpened:
    """A recording before and after undoing its smoothing over time."""

    smooth: CloudRecording
    sharp: CloudRecording
    window: int
    #: Noise of one marker at rest (3,).
    noise_mm: Array
    #: Frames unaffected by lost frames.
    whole: npt.NDArray[np.bool_]
    #: Stretches (frames, markers, 3) without contact.
    still_mm: list[Array]


@dataclass(frozen=True)
class Measured:
    """One part's radius over its episode."""

    frames: list[int]
    #: Radius in every frame, before and after undoing the smoothing.
    smooth: list[RadiusFit]
    sharp: list[RadiusFit]
    #: One radius fitted to all frames.
    joint: RadiusFit
    #: Standard error of the joint radius by leaving out fifths of the episode.
    place_mm: float
    #: Half of the range over the core's thresholds.
    share_mm: float

    @property
    def sigma_mm(self) -> float:
        """Standard error of the joint radius, including the systematic part."""
        return float(np.hypot(np.hypot(self.joint.sigma_mm, self.place_mm), self.share_mm))


def sharpen(recording: CloudRecording, threshold_mm: float) -> Sharpened:
    """Estimate the recorder's averaging window from the noise without contact, and undo it."""
    touched = episodes(recording.indentation_mm(), threshold_mm)
    edges = [0, *(edge for run in touched for edge in (run.start, run.stop)), len(recording)]
    grid = np.arange(recording.rows * recording.cols).reshape(recording.rows, recording.cols)
    markers = grid[_EDGE:-_EDGE, _EDGE:-_EDGE].ravel()
    lost = recording.lost_before
    stretches = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        first, last = start + (_MARGIN if start else 0), stop - (_MARGIN if stop < len(recording) else 0)
        if last - first >= 16 and not lost[first + 1 : last].any():
            stretches.append(recording.points_mm[first:last])
    inside = [stretch[:, markers] for stretch in stretches]
    window = smoothing_frames(inside)
    return Sharpened(
        recording,
        undo_smoothing(recording, window),
        window,
        noise_mm(inside, window),
        intact(recording, window),
        stretches,
    )


def cores_mm(
    recording: CloudRecording, episode: int, contact: int, together: int, share: float, threshold_mm: float
) -> dict[int, Array]:
    """Markers of one contact above a threshold relative to its deepest marker, for every frame of
    an episode.
    """
    indentation = recording.indentation_mm()
    found = {}
    for frame in episodes(indentation, threshold_mm)[episode]:
        touching = contacts(indentation[frame], recording.rows, recording.cols, threshold_mm)
        if len(touching) < together:
            continue
        salient, depth = touching[contact].salient, touching[contact].depth_mm
        core = salient[indentation[frame][salient] >= share * depth]
        # A shallow contact's threshold cuts into the core.
        if len(core) >= _MIN_CORE and share * depth >= threshold_mm:
            found[frame] = recording.points_mm[frame][core]
    return found


def measure_radii(
    sharpened: Sharpened,
    shape: Literal["sphere", "cylinder"],
    place: tuple[int, int, int],
    threshold_mm: float,
) -> Measured:
    """Fit a part's radius to every frame, and one radius to all frames.

    Parameters
    ----------
    place
        Episode, contact in it (the deepest first), and number of contacts.
    """
    whole = sharpened.whole
    # The ratios of x, y and z are preserved.
    noise = sharpened.noise_mm * noise_gain(sharpened.window)
    joint, fifths = {}, {}
    cores: dict[float, dict[int, Array]] = {}
    for share in SHARES:
        found = cores_mm(sharpened.sharp, *place, share, threshold_mm)
        cores[share] = {frame: points for frame, points in found.items() if whole[frame]}
        points = list(cores[share].values())
        joint[share] = fit_radius(points, shape, noise)
        fifths[share] = np.array_split(np.arange(len(points)), _BLOCKS)
    middle = SHARES[1]
    points = list(cores[middle].values())
    without = [
        fit_radius([p for i, p in enumerate(points) if i not in fifth], shape, noise).radius_mm
        for fifth in fifths[middle]
    ]
    # Jackknife (Quenouille 1956, Tukey 1958) over blocks: neighbouring frames share their errors.
    spread = np.sum((np.array(without) - np.mean(without)) ** 2)
    smooth = cores_mm(sharpened.smooth, *place, middle, threshold_mm)
    frames = [frame for frame in cores[middle] if frame in smooth]
    return Measured(
        frames,
        [fit_radius([smooth[frame]], shape, sharpened.noise_mm) for frame in frames],
        [fit_radius([cores[middle][frame]], shape, noise) for frame in frames],
        joint[middle],
        float(np.sqrt((_BLOCKS - 1) / _BLOCKS * spread)),
        0.5 * float(np.ptp([joint[share].radius_mm for share in SHARES])),
    )


def vendor_radii_mm(recording: CloudRecording, folder: Path, shape: str) -> dict[int, list[float]]:
    """Radii from the wheel's own analysis, by frame; it runs unmodified, without the wheel's windows.

    Parameters
    ----------
    folder
        Folder of the recording, for the forces from which the analysis detects contact.
    """
    analyzer = _vendor_analyzer(folder.parents[2], recording.name)
    forces = np.load(folder / "3D_Forces.npy", allow_pickle=False).astype(np.float64)
    radii = {}
    for frame, (points, force) in enumerate(zip(recording.points_mm, forces, strict=True)):
        data: dict[str, Any] = {"SN": recording.name, "3D_Positions": points, "3D_Forces": force}
        analyzer.detectObjects(data)
        objects = [region["object"] for region in data["ContactRegions"]]
        found = [float(o["radius"]) for o in objects if o is not None and o["type"] == shape]
        if found:
            radii[frame] = sorted(found)
    return radii


def _vendor_analyzer(package: Path, serial: str) -> Any:
    # Importing the package itself would load its window libraries.
    shell = ModuleType("PyTac3D")
    shell.__path__ = [str(package)]
    before = sys.modules.get("PyTac3D")
    sys.modules["PyTac3D"] = shell
    try:
        return import_module("PyTac3D.Analyzer").Analyzer(serial)
    finally:
        if before is None:
            del sys.modules["PyTac3D"]
        else:
            sys.modules["PyTac3D"] = before


def radii_table(measured: Mapping[str, Measured], vendor: Mapping[str, Mapping[int, float]]) -> str:
    """Table of the radii of all parts."""
    head = ["part", "frames", "vendor mm", "as recorded mm", "sharpened mm", "noise mm", "one radius mm"]
    head += ["noise", "place", "core"]
    rows = []
    for name, m in measured.items():
        theirs = np.array([vendor[name][frame] for frame in m.frames if frame in vendor[name]])
        rows.append(
            [
                name,
                str(len(m.frames)),
                _range(theirs),
                _range(np.array([fit.radius_mm for fit in m.smooth])),
                _range(np.array([fit.radius_mm for fit in m.sharp])),
                f"{np.median([fit.sigma_mm for fit in m.sharp]):.3f}",
                f"{m.joint.radius_mm:.2f} ± {m.sigma_mm:.2f}",
                f"{m.joint.sigma_mm:.3f}",
                f"{m.place_mm:.3f}",
                f"{m.share_mm:.3f}",
            ]
        )
    return table(head, rows)


def _range(radii: Array) -> str:
    return f"{radii.min():.2f} to {radii.max():.2f}, sd {radii.std():.2f}"


def draw_radii(
    measured: Mapping[str, Measured], vendor: Mapping[str, Mapping[int, float]], path: Path
) -> None:
    """Plot every frame's radius, the vendor's radius, and the joint radius with its error."""
    with needs(__name__):
        import matplotlib

    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(measured), figsize=(15, 4.4), layout="constrained")
    for axis, (name, m) in zip(axes, measured.items(), strict=True):
        theirs = [frame for frame in m.frames if frame in vendor[name]]
        axis.plot(theirs, [vendor[name][f] for f in theirs], ".-", color="0.6", label="vendor's analysis")
        axis.plot(
            m.frames, [fit.radius_mm for fit in m.smooth], ".-", color="tab:orange", label="as recorded"
        )
        radii, sigma = (np.array([getattr(fit, key) for fit in m.sharp]) for key in ("radius_mm", "sigma_mm"))
        axis.plot(m.frames, radii, ".-", color="tab:blue", label="smoothing undone, 1 σ of noise")
        axis.fill_between(m.frames, radii - sigma, radii + sigma, color="tab:blue", alpha=0.3, lw=0)
        joint = m.joint.radius_mm
        axis.axhline(joint, color="k", lw=1, label=f"one radius: {joint:.2f} ± {m.sigma_mm:.2f} mm")
        axis.axhspan(joint - m.sigma_mm, joint + m.sigma_mm, color="k", alpha=0.12, lw=0)
        axis.set(title=name, xlabel="frame", ylabel="radius, mm")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)
