"""Estimated forces of a real sensor beside those that its vendor stated."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from gelstereo.recordings import pytac3d_example
from gelstereo_bench.reports.vendor_forces import RECORDINGS, agreement

pytestmark = pytest.mark.skipif(
    find_spec("PyTac3D") is None,
    reason="the wheel pytac3d is absent (pip install --no-deps pytac3d==3.3.0.9)",
)


@pytest.mark.parametrize(("example", "sensor"), RECORDINGS)
def test_forces_have_the_shape_and_the_signs_of_the_vendors(example: str, sensor: str) -> None:
    found = agreement(pytac3d_example(example, sensor), 6.0, every=12)
    assert found.frames >= 8
    assert found.pressing > 0.8 and min(found.ranks) > 0.5 and found.signs > 0.8


def test_the_layer_explains_more_of_a_drag_than_springs() -> None:
    found = agreement(pytac3d_example(*RECORDINGS[0]), 6.0, every=12)
    assert found.along > found.spring_along + 0.1
