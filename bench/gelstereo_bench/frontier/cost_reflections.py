"""Instructions of whole images with reflections of lights: path-traced ones of half `w`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from gelstereo import Detector, Params
from gelstereo_bench.frontier.cost import UNIT, Cost, Sample, variants
from gelstereo_bench.frontier.scenes import FORMATS
from gelstereo_bench.frontier.table import Report, Table
from gelstereo_bench.frontier.timing import InstructionCounter

__all__ = ["FITTED", "measure_reflections", "reflection_table"]

#: Presets, and the variants whose terms their whole images have.
_PRESETS: Mapping[str, str] = {"fast": "whole soft half", "exact": "whole fine fit"}
#: The sequence whose images the model is fitted to; the others judge it.
FITTED = "w1_press_at_once"


def measure_reflections(source: Path, report: Report, quick: bool = False) -> dict[tuple[str, str], Sample]:
    """Count the instructions of detection in one image of every sequence, by preset and sequence."""
    counter = InstructionCounter(source)
    by_name = {variant.name: variant for variant in variants()}
    images = sorted((source / "bench/outside/data/images").glob("w*_02_left.png"))
    out = {}
    for preset, name in _PRESETS.items():
        params = Params.preset(preset)
        for image in images[:2] if quick else images:
            sequence = image.name.removesuffix("_02_left.png")
            report(f"cost: reflections, {preset}, {sequence}")
            sample = _sample(counter, params, image)
            if sample is not None:
                count, shown, markers = sample
                out[preset, sequence] = Sample(FORMATS[0], 0, by_name[name], markers, shown, count)
    return out


def _sample(
    counter: InstructionCounter, params: Params, image: Path
) -> tuple[int, Mapping[str, int], int] | None:
    """Instructions, what the image shows, and its markers."""
    grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    with tempfile.TemporaryDirectory() as name:
        files = [Path(name) / "params.toml", Path(name) / "image.pgm"]
        params.save(files[0])
        cv2.imwrite(str(files[1]), grey)
        # The first image only warms up.
        count = counter.count("detect", [*files, files[1]])
        shown = counter.workload(*files)
    if count is None or not shown:
        return None
    return count, shown, len(Detector(params).detect(grey))


def reflection_table(samples: Mapping[tuple[str, str], Sample], cost: Cost) -> Table:
    """Counted instructions, how far the model is off, and how far it would be without reflections."""
    sequences = list(dict.fromkeys(sequence for _, sequence in samples))
    rows = []
    for preset in _PRESETS:
        cells = []
        for sequence in sequences:
            sample = samples[preset, sequence]
            work = {name: cost.constants.get(name, 0.0) * n for name, n in sample.multiples.items()}
            units = sample.instructions / UNIT
            off, without = (value / units - 1.0 for value in _with_and_without(work))
            cells.append(f"{1e-6 * sample.instructions:.1f} ({off:+.0%}, {without:+.0%})")
        rows.append([f"preset {preset}", *cells])
    head = ["method", *(_words(sequence) for sequence in sequences)]
    return Table("cost-reflections", head, rows)


def _with_and_without(work: Mapping[str, float]) -> Sequence[float]:
    total = sum(work.values())
    return total, total - work["CLOSED_KILOPIXEL"]


def _words(sequence: str) -> str:
    _, *words = sequence.split("_")
    return " ".join(words) + (" (fitted)" if sequence == FITTED else "")
