"""Error and time of every rung of detection and labels, and of the whole sensing pipeline."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Detector, Error, Params, SimulatedFrame
from gelstereo.extras import needs
from gelstereo_bench.frontier.baseline import Baseline, darker_than_surround, simple_blobs
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.rungs import Rung, rungs_of
from gelstereo_bench.frontier.runners import Runner, geometry_of, repeat_last, write_input
from gelstereo_bench.frontier.scenes import VGA, sphere_press
from gelstereo_bench.frontier.table import Report
from gelstereo_bench.frontier.timing import InstructionCounter, Times, time_side_by_side

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = ["Row", "measure_detection", "measure_labels", "measure_whole"]

Array = npt.NDArray[np.float64]

_MATCH_PX = 3.0
_ROTATIONS_DEG = (0.0, 4.0, 8.0)


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    stage: str
    name: str
    #: Error as text, and as the number for the figure.
    error: str
    value: float
    times: Times
    instructions: int | None
    #: Speed relative to the baseline of its stage, in the same run.
    speed: float
    baseline: bool = False


def _rows(
    stage: str,
    errors: Sequence[tuple[str, str, float]],
    times: dict[str, Times],
    yardstick: str,
    instructions: dict[str, int | None],
) -> list[Row]:
    reference_ms = times[yardstick].median_ms
    return [
        Row(
            stage,
            name,
            text,
            value,
            times[name],
            instructions.get(name),
            reference_ms / times[name].median_ms,
            name not in instructions,
        )
        for name, text, value in errors
    ]


# Detection


def measure_detection(rounds: int, counter: InstructionCounter, report: Report) -> list[Row]:
    """Measure the distance of detected from true centres, and the time per view."""
    frames = sphere_press()[::3]
    detectors: dict[str, Callable[[npt.NDArray[np.uint8]], Array]] = {}
    instructions: dict[str, int | None] = {}
    for rung in rungs_of("detect"):
        detectors[rung.name] = _native_detector(rung)
        with tempfile.TemporaryDirectory() as folder:
            report(f"detect: {rung.name}")
            files = write_input(Path(folder), rung.params(), frames[-2:])
            instructions[rung.name] = counter.count("detect", files)
    yardstick = "OpenCV: gaussian + components (baseline)"
    detectors[yardstick] = _baseline_detector(box=False, centre="binary")
    detectors["OpenCV: gaussian + SimpleBlobDetector"] = _blob_detector
    detectors["OpenCV: box + grey centroid"] = _baseline_detector(box=True, centre="grey")
    fast = FastBaseline(geometry_of(VGA.rig()), Params.preset("balanced").to_dict())
    detectors["OpenCV: box + grey windows (fast)"] = fast.detect
    errors = []
    for name, detect in detectors.items():
        squared, missed, false = [], 0, 0
        for frame in frames:
            found = detect(frame.left)
            distance = cKDTree(frame.left_px).query(found)[0]
            squared += (distance[distance < _MATCH_PX] ** 2).tolist()
            false += int((distance >= _MATCH_PX).sum())
            missed += int((cKDTree(found).query(frame.left_px)[0] >= _MATCH_PX).sum())
        rms_px = float(np.sqrt(np.mean(squared)))
        errors.append((name, f"{rms_px:.3f} px rms, {missed} missed, {false} false", rms_px))
    calls = {name: _on_images(detect, frames) for name, detect in detectors.items()}
    return _rows("detect", errors, time_side_by_side(calls, rounds), yardstick, instructions)


def _native_detector(rung: Rung) -> Callable[[npt.NDArray[np.uint8]], Array]:
    detector = Detector(rung.params())
    return lambda image: detector.detect(image).centres_px


def _baseline_detector(box: bool, centre: str) -> Callable[[npt.NDArray[np.uint8]], Array]:
    settings = Params().replace(detect={"centre": centre}).to_dict()
    return Baseline(geometry_of(VGA.rig()), settings, box=box).detect


def _blob_detector(image: npt.NDArray[np.uint8]) -> Array:
    detect = Params().to_dict()["detect"]
    kernels = {name: detect[name] for name in ("smooth_kernel_px", "background_kernel_px")}
    limits = {name: detect[name] for name in ("threshold_levels", "min_area_px2", "max_area_px2")}
    return simple_blobs(darker_than_surround(image, **kernels), **limits)


def _on_images(
    detect: Callable[[npt.NDArray[np.uint8]], Array], frames: Sequence[SimulatedFrame]
) -> Callable[[int], object]:
    return lambda turn: detect(frames[turn % len(frames)].left)


# Labels


def measure_labels(rounds: int, counter: InstructionCounter, report: Report) -> list[Row]:
    """Measure the share of wrong labels on turned lattices under a press, and the time of a whole frame."""
    presses = [sphere_press(float(np.deg2rad(degrees))) for degrees in _ROTATIONS_DEG]
    errors, calls, instructions = [], {}, {}
    yardstick = "OpenCV + Algorithm 1 (baseline)"
    baseline = Params.preset("balanced").replace({"label": {"method": "foresight"}})
    for name, params in [(rung.name, rung.params()) for rung in rungs_of("label")] + [(yardstick, baseline)]:
        report(f"label: {name}")
        wrong: list[float | None] = []
        refusals = 0
        for press in presses:
            runner = Runner(VGA.rig(), params, native=name != yardstick)
            wrong.append(_wrong_labels(runner, press))
            refusals += runner.refusals
        text = " / ".join("refused" if share is None else f"{100 * share:.1f}" for share in wrong)
        degrees = " / ".join(f"{d:.0f}" for d in _ROTATIONS_DEG)
        known = [1.0 if share is None else share for share in wrong]
        text = f"{text} % wrong at {degrees} deg"
        if refusals:
            text += (
                f"; sorting refused {refusals} of {sum(map(len, presses))} frames, which tracking labelled"
            )
        errors.append((name, text, 100.0 * float(np.mean(known))))
        calls[name] = repeat_last(Runner(VGA.rig(), params, native=name != yardstick), presses[0])
        if name != yardstick:
            with tempfile.TemporaryDirectory() as folder:
                files = write_input(Path(folder), params, presses[0], VGA.rig())
                instructions[name] = counter.count("frame", files)
    return _rows("label", errors, time_side_by_side(calls, rounds), yardstick, instructions)


def _wrong_labels(runner: Runner, press: Sequence[SimulatedFrame]) -> float | None:
    """Share of markers in the last frame whose position is more than a third of a pitch from the truth."""
    try:
        for frame in press:
            left_px, _, _ = runner.process(frame)
    except (Error, ValueError):
        return None
    pitch_px = float(np.median(cKDTree(press[0].left_px).query(press[0].left_px, k=2)[0][:, 1]))
    return float(np.mean(np.linalg.norm(left_px - press[-1].left_px, axis=1) > pitch_px / 3.0))


# The whole pipeline


def measure_whole(rounds: int, counter: InstructionCounter, report: Report) -> list[Row]:
    """Measure the distance of points from the truth along z, and the time of a stereo frame."""
    press = sphere_press()
    errors, calls, instructions = [], {}, {}
    yardstick = "OpenCV pipeline (baseline)"
    for name, params in [(rung.name, rung.params()) for rung in rungs_of("whole")] + [(yardstick, Params())]:
        report(f"whole: {name}")
        runner = Runner(VGA.rig(), params, native=name != yardstick)
        z_error: list[float] = []
        for frame in press:
            _, points_mm, seen = runner.process(frame)
            z_error += (points_mm - frame.points_mm)[seen, 2].tolist()
        rms_um = 1e3 * float(np.sqrt(np.mean(np.square(z_error))))
        errors.append((name, f"depth {rms_um:.1f} um rms", rms_um))
        calls[name] = repeat_last(Runner(VGA.rig(), params, native=name != yardstick), press)
        if name != yardstick:
            with tempfile.TemporaryDirectory() as folder:
                files = write_input(Path(folder), params, press, VGA.rig())
                instructions[name] = counter.count("frame", files)
    return _rows("whole", errors, time_side_by_side(calls, rounds), yardstick, instructions)
