"""Data sets as files of NumPy and zarr."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo.datasets.rendering import DatasetError
from gelstereo.datasets.sample import Array, Sample
from gelstereo.export.folder import new_folder
from gelstereo.extras import needs

#: Frames of one chunk of a zarr array: some 10 MB of images of 640 x 480.
_CHUNK_FRAMES = 32


def write_npz(samples: Iterable[Sample], folder: str | Path, *, samples_per_file: int = 64) -> int:
    """Write samples as compressed NumPy files, ``00000.npz`` and so on, to a new folder.

    Every array of `Sample.frames` is in each file under its name, all frames of all samples one after the
    other, (F, ...). ``sample`` (F,) is the number of the sample of each frame. ``seed`` (S,), and
    ``rest_left``, ``rest_right`` and ``rest_points_mm``, (S, ...), have one entry for each of the file's
    samples.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    DatasetError
        If samples differ in their arrays or shapes.
    ExportError
        If the folder exists.
    """
    if samples_per_file < 1:
        raise DatasetError(f"samples_per_file is {samples_per_file}; valid is 1 or more")
    frames, number = 0, 0
    with new_folder(Path(folder)) as unfinished:
        for arrays in _groups(samples, samples_per_file):
            # NumPy's types take any keyword for its own.
            np.savez_compressed(unfinished / f"{number:05}.npz", **arrays)  # type: ignore[arg-type]
            frames, number = frames + len(arrays["sample"]), number + 1
    return frames


def write_zarr(samples: Iterable[Sample], folder: str | Path) -> int:
    """Write samples as a group of zarr arrays to a new folder; needs the extra ``zarr``.

    The arrays are those of `write_npz`, in one group: ``zarr.open_group(folder)["left"]`` has all frames.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    DatasetError
        If samples differ in their arrays or shapes.
    ExportError
        If the folder exists.
    MissingExtra
        If zarr is missing.
    """
    with needs("write_zarr"):
        import zarr
    with new_folder(Path(folder)) as unfinished:
        group: Any = zarr.open_group(str(unfinished), mode="w")
        for arrays in _groups(samples, _CHUNK_FRAMES):
            for name, values in arrays.items():
                if name not in group:
                    chunks = (_CHUNK_FRAMES, *values.shape[1:])
                    shape = (0, *values.shape[1:])
                    group.create_array(name, shape=shape, chunks=chunks, dtype=values.dtype)
                group[name].append(values)
        return int(group["sample"].shape[0])


def _groups(samples: Iterable[Sample], size: int) -> Iterator[dict[str, Array]]:
    """Arrays of so many samples at a time, with the same names and shapes."""
    held: list[Sample] = []
    first: Sample | None = None
    for sample in samples:
        first = first or sample
        _check_alike(sample, first)
        held.append(sample)
        if len(held) == size:
            yield _arrays(held)
            held = []
    if first is None:
        raise DatasetError("there is no sample to write; valid is one or more")
    if held:
        yield _arrays(held)


def _arrays(samples: list[Sample]) -> dict[str, Array]:
    names, rest = samples[0].frames, samples[0].rest
    counts = [len(sample.frames["time_s"]) for sample in samples]
    return {
        **{name: np.concatenate([sample.frames[name] for sample in samples]) for name in names},
        "sample": np.repeat([sample.index for sample in samples], counts),
        "seed": np.array([sample.seed for sample in samples], dtype=np.int64),
        **{f"rest_{name}": np.stack([sample.rest[name] for sample in samples]) for name in rest},
    }


def _check_alike(sample: Sample, first: Sample) -> None:
    def shapes(of: Sample) -> dict[str, tuple[int, ...]]:
        return {name: values.shape[1:] for name, values in of.frames.items()}

    found, expected = shapes(sample), shapes(first)
    for name in sorted({*found, *expected}):
        if found.get(name) != expected.get(name):
            here, there = found.get(name, "missing"), expected.get(name, "missing")
            raise DatasetError(
                f"{name} of sample {sample.index} is {here}, and {there} in sample {first.index}; valid are "
                "scenes with the same image size, lattice and kind of gel"
            )
