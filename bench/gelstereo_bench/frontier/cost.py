"""Cost model: instructions of each stage as a linear function of pixels, markers and the markers' area."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, Pipeline, SimulatedFrame
from gelstereo.extras import needs
from gelstereo.tune.rungs import Rung, params_of, rungs_of
from gelstereo_bench.frontier.runners import write_input
from gelstereo_bench.frontier.scenes import FORMATS, Format, sphere_press
from gelstereo_bench.frontier.table import Report, Table
from gelstereo_bench.frontier.timing import InstructionCounter, Stopwatch, Times

with needs(__name__):
    from scipy.optimize import nnls

__all__ = ["Cost", "Sample", "cost_table", "fit_costs", "measure_costs", "rust_lines", "time_table"]

Array = npt.NDArray[np.float64]

#: Instructions of a unit of work.
UNIT = 1000.0
#: What a term grows with.
PARTS = ("base", "per kilopixel", "per marker", "per marker and px²")
#: Terms of `pipeline/work.rs` that are paid once for each view; the others once for each frame.
DETECT_TERMS = (
    "WHOLE_GAUSSIAN",
    "WHOLE_GREY",
    "WHOLE_SOFT",
    "WHOLE_SOFT_HALF",
    "WHOLE_FIT",
    "WHOLE_FINE_FIT",
    "WINDOWS_SOFT",
    "WINDOWS_FIT",
    "WINDOWS_FINE_FIT",
)
FRAME_TERMS = ("FRAME", "RAYS", "DISC_BIAS", "PRESSURE", "ADAPTIVE")
#: Terms whose instructions wait for each other's results: divisions and roots of one marker after the other.
#: They take 1.5 to 2 times as long as those over pixels.
SLOW_TERMS = ("RAYS", "DISC_BIAS")
#: Three short measurements of 640x480 images, with the markers' number per side. They give a machine's time
#: for a unit of work and, by the last one, for a unit of slow work.
REFERENCES = (("whole fit", 25), ("windows fit", 25), ("rays, disc bias", 25))
#: Which parts a term has; what the data cannot tell apart is left to one term.
_SHAPES: Mapping[str, tuple[bool, ...]] = {
    **{term: (True, True, True, True) for term in DETECT_TERMS if term.startswith("WHOLE")},
    **{term: (True, False, True, True) for term in DETECT_TERMS if "WINDOWS" in term},
    **dict.fromkeys(FRAME_TERMS, (False, False, True, False)),
}
_SIZES: tuple[tuple[Format, int], ...] = (
    (FORMATS[0], 25),
    (FORMATS[0], 45),
    (FORMATS[0], 71),
    (FORMATS[1], 25),
    (FORMATS[1], 45),
    (FORMATS[2], 25),
    (FORMATS[2], 71),
)


@dataclass(frozen=True)
class Variant:
    """Settings, and the terms that their frames pay."""

    name: str
    terms: tuple[str, ...]
    changes: Mapping[str, object]


@dataclass(frozen=True)
class Sample:
    """Instructions of one variant on one size."""

    size: Format
    lattice: int
    variant: Variant
    pixels: int
    markers: int
    marker_px2: float
    instructions: float
    #: Median time on this machine; NaN if not measured.
    median_ms: float

    def row(self, columns: Sequence[tuple[str, int]]) -> Array:
        """Multiple of each coefficient."""
        return np.array([self._times(term, part) for term, part in columns])

    def _times(self, term: str, part: int) -> float:
        if term not in self.variant.terms:
            return 0.0
        parts = (1.0, 1e-3 * self.pixels, self.markers, self.markers * self.marker_px2)
        return (2.0 if term in DETECT_TERMS else 1.0) * parts[part]


@dataclass(frozen=True)
class Cost:
    """A fitted model."""

    coefficients: Mapping[tuple[str, int], float]
    #: Predicted over counted instructions, for each sample.
    ratios: Sequence[float]
    #: Those of slow work, of `SLOW_TERMS`.
    slow_ratios: Sequence[float]


def _variants() -> list[Variant]:
    polynomial, rays, corrected = (rung.settings for rung in rungs_of("points"))
    depth = {"contact.saliency": "depth"}
    detect: dict[str, Rung] = {rung.name: rung for rung in rungs_of("detect")}

    def searched(term: str, name: str, **more: object) -> Variant:
        settings = {**detect[name].settings, **polynomial, **depth, **more}
        return Variant(term.lower().replace("_", " "), (term, "FRAME"), settings)

    full = {"detect.find_at": "full_size"}
    grey = {"detect.centre": "grey", "detect.find_at": "full_size"}
    paper = {**grey, "detect.background": "gaussian"}
    cheap = {**detect["soft threshold, windows"].settings}
    soft = ("WINDOWS_SOFT", "FRAME")
    return [
        searched("WHOLE_GAUSSIAN", "soft threshold, whole images", **paper),
        searched("WHOLE_GREY", "soft threshold, whole images", **grey),
        searched("WHOLE_SOFT", "soft threshold, whole images", **full),
        searched("WHOLE_SOFT_HALF", "soft threshold, whole images"),
        searched("WHOLE_FIT", "fit, whole images"),
        searched("WHOLE_FINE_FIT", "fine fit, whole images"),
        searched("WINDOWS_SOFT", "soft threshold, windows"),
        searched("WINDOWS_FIT", "fit, windows"),
        searched("WINDOWS_FINE_FIT", "fine fit, windows"),
        Variant("rays", (*soft, "RAYS"), {**cheap, **depth, **rays}),
        Variant("rays, disc bias", (*soft, "RAYS", "DISC_BIAS"), {**cheap, **depth, **corrected}),
        Variant("pressure", (*soft, "PRESSURE"), {**cheap, **polynomial, "contact.saliency": "pressure"}),
        Variant("adaptive", (*soft, "ADAPTIVE"), {**cheap, **polynomial, "contact.saliency": "adaptive"}),
    ]


def measure_costs(source: Path, report: Report, quick: bool = False) -> list[Sample]:
    """Count the instructions of tracked frames of a press, for each variant on each size."""
    counter, program = InstructionCounter(source), Stopwatch.program(source)
    out = []
    for size, lattice in _SIZES[:3] if quick else _SIZES:
        scene = size.scene(lattice)
        frames = sphere_press(scene=scene)[::4]
        pitch_mm = scene.to_dict()["gel"]["pitch_mm"]
        for variant in _variants():
            report(f"cost: {size.name}, {lattice}x{lattice} markers, {variant.name}")
            params = params_of(()).replace({**variant.changes, "lattice.pitch_mm": pitch_mm})
            sample = _sample(size, lattice, variant, params, frames, counter, program)
            if sample is not None:
                out.append(sample)
    return out


def _sample(
    size: Format,
    lattice: int,
    variant: Variant,
    params: Params,
    frames: Sequence[SimulatedFrame],
    counter: InstructionCounter,
    program: Path | None,
) -> Sample | None:
    """`None` if the pipeline refuses the images, or searches whole images instead of windows."""
    pipeline = Pipeline(size.rig(), params)
    wanted = "windows" if variant.terms[0].startswith("WINDOWS") else "whole"
    try:
        found = [pipeline.process(frame.left, frame.right) for frame in frames]
    except Error:
        return None
    if any(view.searched != wanted for frame in found[1:] for view in (frame.left, frame.right)):
        return None
    with tempfile.TemporaryDirectory() as folder:
        files = write_input(Path(folder), params, frames, size.rig())
        counts = counter.count_each("frames", files)
        median_ms = _median_ms(program, files)
    if not counts:
        return None
    radius_px = _radius_px(size, frames[0], pipeline)
    width, height = size.size_px
    return Sample(
        size,
        lattice,
        variant,
        width * height,
        found[0].rows * found[0].cols,
        float(np.pi * radius_px**2),
        float(np.median(counts[len(counts) // 2 :])),
        median_ms,
    )


def _median_ms(program: Path | None, files: Sequence[Path]) -> float:
    """Of tracked frames after the map of points is fitted."""
    if program is None:
        return float("nan")
    with Stopwatch(program, files) as watch:
        return Times.of(watch.times_ns("track", 80)[40:]).median_ms


def _radius_px(size: Format, rest: SimulatedFrame, pipeline: Pipeline) -> float:
    """Radius of the usual marker, as detection sees it."""
    from gelstereo import Detector

    areas = Detector(pipeline.params).detect(rest.left).area_px2
    return float(np.sqrt(np.median(areas) / np.pi))


def fit_costs(samples: Sequence[Sample]) -> Cost:
    """Non-negative least squares of relative errors."""
    present = dict.fromkeys(term for sample in samples for term in sample.variant.terms)
    columns = [(term, part) for term in present for part in range(len(PARTS)) if _SHAPES[term][part]]
    counted = np.array([sample.instructions for sample in samples]) / UNIT
    rows = np.array([sample.row(columns) for sample in samples])
    found, _ = nnls(rows / counted[:, None], np.ones(len(samples)))
    is_slow = np.array([term in SLOW_TERMS for term, _ in columns])
    slow = rows[:, is_slow] @ found[is_slow]
    return Cost(dict(zip(columns, found, strict=True)), list(rows @ found / counted), list(slow / counted))


def cost_table(samples: Sequence[Sample], cost: Cost) -> Table:
    """Predicted over counted instructions."""
    head = ["method", *(f"{size.name}, {lattice}x{lattice}" for size, lattice in _SIZES)]
    cells: dict[str, dict[tuple[str, int], str]] = {}
    for sample, ratio in zip(samples, cost.ratios, strict=True):
        text = f"{1e-6 * sample.instructions:.2f} ({ratio - 1.0:+.0%})"
        cells.setdefault(sample.variant.name, {})[sample.size.name, sample.lattice] = text
    rows = [[name, *(line.get((size.name, n), "-") for size, n in _SIZES)] for name, line in cells.items()]
    return Table("cost", head, rows)


def time_table(samples: Sequence[Sample], cost: Cost) -> Table:
    """Measured times, and how far predictions from the three short measurements are off."""
    counted = 1e-6 * np.array([sample.instructions for sample in samples])
    slow = counted * np.array(cost.slow_ratios)
    usual = counted * np.array(cost.ratios) - slow
    measured_ms = np.array([sample.median_ms for sample in samples])
    places = {(sample.variant.name, sample.size.name, sample.lattice): k for k, sample in enumerate(samples)}
    known = [places[name, _SIZES[0][0].name, lattice] for name, lattice in REFERENCES]
    work = np.column_stack((usual, slow))
    ms_per_unit, _ = nnls(work[known] / measured_ms[known, None], np.ones(len(known)))
    predicted_ms = work @ ms_per_unit
    head = ["method", *(f"{size.name}, {lattice}x{lattice}" for size, lattice in _SIZES)]
    cells: dict[str, dict[tuple[str, int], str]] = {}
    for k, sample in enumerate(samples):
        off = predicted_ms[k] / sample.median_ms - 1.0
        text = f"{sample.median_ms:.2f} ({off:+.0%})"
        cells.setdefault(sample.variant.name, {})[sample.size.name, sample.lattice] = text
    rows = [[name, *(line.get((size.name, n), "-") for size, n in _SIZES)] for name, line in cells.items()]
    return Table("cost-times", head, rows)


def rust_lines(cost: Cost) -> str:
    """The constants of `pipeline/work.rs`."""
    lines = []
    for term in dict.fromkeys(term for term, _ in cost.coefficients):
        values = (cost.coefficients.get((term, part), 0.0) for part in range(len(PARTS)))
        lines.append(f"const {term}: Cost = cost({', '.join(f'{value:.3g}' for value in values)});")
    return "\n".join(lines)
