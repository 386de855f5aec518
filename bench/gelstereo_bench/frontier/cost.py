"""Cost model: instructions of each stage as a linear function of what a frame shows before it is searched."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, Pipeline, SimulatedFrame
from gelstereo.extras import needs
from gelstereo.tune.rungs import Rung, params_of, rungs_of
from gelstereo_bench.frontier.runners import write_input
from gelstereo_bench.frontier.scenes import FORMATS, LATTICES, Format, sphere_press
from gelstereo_bench.frontier.table import Report, Table
from gelstereo_bench.frontier.timing import InstructionCounter, Stopwatch, Times

with needs(__name__):
    from scipy.optimize import nnls

__all__ = [
    "Cost",
    "Sample",
    "Timed",
    "cost_table",
    "fit_costs",
    "measure_costs",
    "measure_times",
    "rust_lines",
    "time_table",
    "variants",
]

Array = npt.NDArray[np.float64]

#: Instructions of a unit of work.
UNIT = 1000.0
#: Markers from which soft thresholds learn their profile, as in the core.
_PROFILE_MARKERS = 625
#: Three short measurements of 640x480 images, with the markers' number per side. They give a machine's time
#: for a unit of work and, by the last one, for a unit of slow work: rays and disc bias, whose instructions
#: wait for each other's results. They take 1.5 to 2 times as long as those over pixels.
REFERENCES = (("whole fit", 25), ("windows fit", 25), ("rays, disc bias", 25))
_SLOW, _WITHOUT = ("rays", "rays, disc bias"), "windows soft"
_SIZES: tuple[tuple[Format, int], ...] = tuple((size, count) for size in FORMATS for count in LATTICES)


@dataclass(frozen=True)
class Variant:
    """Settings, the methods of detection that they use, and the terms of later stages."""

    name: str
    detect: str
    changes: Mapping[str, object]
    later: tuple[str, ...] = ()

    @property
    def searched(self) -> str:
        """Where markers are searched for in tracked frames."""
        return self.detect.split()[0]


@dataclass(frozen=True)
class Sample:
    """Instructions of one variant on one size, and what its rest frame shows.

    Those of a tracked stereo frame, or of the detection in a single image (`lattice` 0).
    """

    size: Format
    lattice: int
    variant: Variant
    markers: int
    #: Of the core's program: `usual_px2`, and the fields of `Workload`.
    shown: Mapping[str, int]
    instructions: float

    @property
    def multiples(self) -> Mapping[str, float]:
        """Of each constant of `pipeline/work.rs`."""
        later = ("FRAME", *self.variant.later) if self.lattice else ()
        out = defaultdict(float, {name: float(self.markers) for name in later})
        for name, of_view in self._of_view():
            out[name] += of_view * (2.0 if self.lattice else 1.0)
        return out

    def _of_view(self) -> Iterator[tuple[str, float]]:
        detect, is_whole = self.variant.detect, self.variant.searched == "whole"
        if is_whole:
            yield from self._segmented()
        else:
            yield "GLARE_KILOPIXEL", self._kilopixels
        if "soft" in detect or not is_whole:
            yield "WINDOW_ROW", self.markers * self._side_px * (1 if self._side_px <= 16 else 2)
        if "soft" in detect and is_whole:
            yield "PROFILE_PIXEL", min(self.markers, _PROFILE_MARKERS) * self._side_px**2
        if "fit" in detect:
            yield from self._fitted(is_whole)

    def _segmented(self) -> Iterator[tuple[str, float]]:
        detect, rows = self.variant.detect, self.markers * self._diameter_px
        width, height = self.size.size_px
        scale = 0.5 if self.shown["is_half_size"] else 1.0
        if detect == "whole gaussian":
            yield "GAUSSIAN_KILOPIXEL", self._kilopixels
        else:
            yield "SEGMENT_KILOPIXEL", self._kilopixels * scale**2
        yield "SEGMENT_ROW", rows * scale
        yield "CLOSED_KILOPIXEL", 1e-3 * self.shown["closed_px"]
        if detect in ("whole gaussian", "whole grey"):
            yield "GREY_ROW", rows
        yield "NOISE_KILOPIXEL", 1e-3 * self.shown["noise_rows"] * width
        yield "NOISE_ROW", self.shown["rows_beside_noise"] * rows / height

    def _fitted(self, is_whole: bool) -> Iterator[tuple[str, float]]:
        groups = self.markers * self.shown["fit_groups"]
        if is_whole:
            yield "LEARN_FIT", 1.0
        yield "FIT_MARKER", self.markers
        yield "FIT_GROUP", groups
        if "fine" in self.variant.detect:
            yield "FINE_MARKER", self.markers
            yield "FINE_GROUP", groups
            yield "FINE_SUM_GROUP", groups * self.shown["sums_pixels"]

    @property
    def _kilopixels(self) -> float:
        return 1e-3 * self.size.size_px[0] * self.size.size_px[1]

    @property
    def _diameter_px(self) -> float:
        return 2.0 * float(np.sqrt(self.shown["usual_px2"] / np.pi))

    @property
    def _side_px(self) -> int:
        """Side of a marker's window, as in `detect/window/size.rs`."""
        is_small = 0.5 * self._diameter_px < 1.8
        edge_px, slack_px = (1.25, 2.0) if is_small else (2.5, 3.0)
        return int(self._diameter_px + 2.0 * edge_px + slack_px)


@dataclass(frozen=True)
class Cost:
    """A fitted model."""

    #: Constants of `pipeline/work.rs`, by name.
    constants: Mapping[str, float]
    #: Predicted over counted instructions, for each sample.
    ratios: Sequence[float]
    #: The same by constants that were fitted to the samples of all other sizes.
    left_out: Sequence[float]


@dataclass(frozen=True)
class Timed:
    """Predicted work of one variant on one size, and its time on this machine."""

    size: Format
    lattice: int
    variant: Variant
    #: Units of a tracked frame.
    work: int
    median_ms: float


def variants() -> list[Variant]:
    """All settings whose work is counted."""
    polynomial, rays, corrected = (rung.settings for rung in rungs_of("points"))
    depth = {"contact.saliency": "depth"}
    detect: dict[str, Rung] = {rung.name: rung for rung in rungs_of("detect")}

    def searched(detects: str, name: str, **more: object) -> Variant:
        settings = {**detect[name].settings, **polynomial, **depth, **more}
        return Variant(detects, detects, settings)

    full = {"detect.find_at": "full_size"}
    grey = {"detect.centre": "grey", "detect.find_at": "full_size"}
    paper = {**grey, "detect.background": "gaussian"}
    cheap = {**detect["soft threshold, windows"].settings}
    return [
        searched("whole gaussian", "soft threshold, whole images", **paper),
        searched("whole grey", "soft threshold, whole images", **grey),
        searched("whole soft", "soft threshold, whole images", **full),
        searched("whole soft half", "soft threshold, whole images"),
        searched("whole fit", "fit, whole images"),
        searched("whole fine fit", "fine fit, whole images"),
        searched("windows soft", "soft threshold, windows"),
        searched("windows fit", "fit, windows"),
        searched("windows fine fit", "fine fit, windows"),
        Variant("rays", _WITHOUT, {**cheap, **depth, **rays}, ("RAYS",)),
        Variant("rays, disc bias", _WITHOUT, {**cheap, **depth, **corrected}, ("RAYS", "DISC_BIAS")),
        Variant("pressure", _WITHOUT, {**cheap, **polynomial, "contact.saliency": "pressure"}, ("PRESSURE",)),
        Variant("adaptive", _WITHOUT, {**cheap, **polynomial, "contact.saliency": "adaptive"}, ("ADAPTIVE",)),
    ]


@dataclass(frozen=True)
class _Trial:
    """One variant on one size: the frames of a press, and what the pipeline found in them."""

    size: Format
    lattice: int
    variant: Variant
    params: Params
    frames: Sequence[SimulatedFrame]
    markers: int
    work: int


def _trials(report: Report, quick: bool) -> Iterator[_Trial]:
    """Without those that the pipeline refuses, or in which it searches whole images instead of windows."""
    for size, lattice in _SIZES[:3] if quick else _SIZES:
        scene = size.scene(lattice)
        frames = sphere_press(scene=scene)[::4]
        pitch_mm = scene.to_dict()["gel"]["pitch_mm"]
        for variant in variants():
            report(f"cost: {size.name}, {lattice}x{lattice} markers, {variant.name}")
            params = params_of(()).replace({**variant.changes, "lattice.pitch_mm": pitch_mm})
            pipeline = Pipeline(size.rig(), params)
            try:
                rest, *found = [pipeline.process(frame.left, frame.right) for frame in frames]
            except Error:
                continue
            views = [view for frame in found for view in (frame.left, frame.right)]
            if all(view.searched == variant.searched for view in views):
                yield _Trial(size, lattice, variant, params, frames, rest.rows * rest.cols, found[-1].work)


def measure_costs(source: Path, report: Report, quick: bool = False) -> list[Sample]:
    """Count the instructions of tracked frames of a press, for each variant on each size."""
    counter = InstructionCounter(source)
    out = []
    for trial in _trials(report, quick):
        with tempfile.TemporaryDirectory() as folder:
            files = write_input(Path(folder), trial.params, trial.frames, trial.size.rig())
            counts = counter.count_each("frames", files)
            shown = counter.workload(files[0], files[2])
        if counts and shown:
            usual = float(np.median(counts[len(counts) // 2 :]))
            out.append(Sample(trial.size, trial.lattice, trial.variant, trial.markers, shown, usual))
    return out


def measure_times(source: Path, report: Report, quick: bool = False) -> list[Timed]:
    """Measure the times of tracked frames of a press after the map of points is fitted, for each variant on
    each size.
    """
    program = Stopwatch.program(source)
    if program is None:
        return []
    out = []
    for trial in _trials(report, quick):
        with tempfile.TemporaryDirectory() as folder:
            files = write_input(Path(folder), trial.params, trial.frames, trial.size.rig())
            with Stopwatch(program, files) as watch:
                median_ms = Times.of(watch.times_ns("track", 80)[40:]).median_ms
        out.append(Timed(trial.size, trial.lattice, trial.variant, trial.work, median_ms))
    return out


def fit_costs(samples: Sequence[Sample]) -> Cost:
    """Non-negative least squares of relative errors."""
    every = [sample.multiples for sample in samples]
    names = list(dict.fromkeys(name for multiples in every for name in multiples))
    counted = np.array([sample.instructions for sample in samples]) / UNIT
    rows = np.array([[multiples[name] for name in names] for multiples in every]) / counted[:, None]
    found, _ = nnls(rows, np.ones(len(samples)))
    places = [(sample.size, sample.lattice) for sample in samples]
    left_out = np.full(len(samples), np.nan)
    for place in dict.fromkeys(places):
        here = np.array([other == place for other in places])
        left_out[here] = rows[here] @ nnls(rows[~here], np.ones(int((~here).sum())))[0]
    return Cost(dict(zip(names, found, strict=True)), list(rows @ found), list(left_out))


def cost_table(samples: Sequence[Sample], cost: Cost) -> Table:
    """Counted instructions of the samples that were fitted, and how far both models are off."""
    cells = {}
    for sample, ratio, left_out in zip(samples, cost.ratios, cost.left_out, strict=True):
        if not sample.lattice:
            continue
        off = f"{ratio - 1.0:+.0%}, {left_out - 1.0:+.0%}"
        place = (sample.variant.name, sample.size.name, sample.lattice)
        cells[place] = f"{1e-6 * sample.instructions:.2f} ({off})"
    return _table("cost", cells)


def time_table(timed: Sequence[Timed]) -> Table:
    """Measured times, and how far predictions from the three short measurements are off."""
    places = {(one.variant.name, one.size.name, one.lattice): k for k, one in enumerate(timed)}
    work, measured_ms = np.array([one.work for one in timed]), np.array([one.median_ms for one in timed])
    slow = np.zeros(len(timed))
    for (name, size, lattice), k in places.items():
        if name in _SLOW:
            slow[k] = work[k] - work[places[_WITHOUT, size, lattice]]
    parts = np.column_stack((work - slow, slow))
    known = [places[name, FORMATS[0].name, lattice] for name, lattice in REFERENCES]
    ms_per_unit, _ = nnls(parts[known] / measured_ms[known, None], np.ones(len(known)))
    off = parts @ ms_per_unit / measured_ms - 1.0
    cells = {place: f"{measured_ms[k]:.2f} ({off[k]:+.0%})" for place, k in places.items()}
    return _table("cost-times", cells)


def _table(name: str, cells: Mapping[tuple[str, str, int], str]) -> Table:
    head = ["method", *(f"{size.name}, {lattice}x{lattice}" for size, lattice in _SIZES)]
    methods = dict.fromkeys(method for method, *_ in cells)
    rows = [[one, *(cells.get((one, size.name, n), "-") for size, n in _SIZES)] for one in methods]
    return Table(name, head, rows)


def rust_lines(cost: Cost) -> str:
    """The constants of `pipeline/work.rs`."""
    return "\n".join(f"const {name}: f64 = {value:.3g};" for name, value in cost.constants.items())
