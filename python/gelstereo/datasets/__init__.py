"""Data sets of simulated contacts: random scenes, rendered on several processes and written to files."""

from __future__ import annotations

from gelstereo.datasets.files import write_npz, write_zarr
from gelstereo.datasets.rendering import DatasetError, render
from gelstereo.datasets.sample import Sample, simulate_sample

__all__ = ["DatasetError", "Sample", "render", "simulate_sample", "write_npz", "write_zarr"]
