"""The print's pitch at rest is a check of rig and settings."""

from __future__ import annotations

import re
import warnings

import pytest

from gelstereo import Params, Pipeline, PitchWarning, Rig, simulate


def rest(pitch_mm: float | list[float], baseline_scale: float = 1.0) -> Pipeline:
    """A pipeline after its rest frame, with another pitch or baseline than the simulated sensor's 0.9 and 8
    mm.
    """
    sensor = simulate({"effects.sensor_noise.sigma_levels": 1.0})
    rig = Rig.parallel((640, 480), 560.0, 8.0 * baseline_scale)
    pipeline = Pipeline(rig, Params.preset("balanced").replace({"lattice.pitch_mm": pitch_mm}))
    pipeline.process(sensor[0].left, sensor[0].right)
    return pipeline


def test_a_right_pitch_is_confirmed() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check = rest(0.9).pitch_check
    assert check is not None and not check.is_off
    assert check.expected_mm == (0.9, 0.9)
    # 5 standard deviations: once in 1.7 million.
    for measured_mm, sigma_mm in zip(check.measured_mm, check.sigma_mm, strict=True):
        assert measured_mm == pytest.approx(0.9, abs=5 * sigma_mm)


@pytest.mark.parametrize("pitch_mm", [0.85, 0.95, 1.5, [0.9, 0.95], [0.85, 0.9]])
def test_a_wrong_setting_is_warned_of_with_both_numbers(pitch_mm: float | list[float]) -> None:
    named = re.escape(str(pitch_mm))
    with pytest.warns(PitchWarning, match=rf"0\.9\d* ± .* lattice\.pitch_mm is {named}.*square.*baseline"):
        check = rest(pitch_mm).pitch_check
    assert check is not None and check.is_off


def test_a_wrong_baseline_is_warned_of() -> None:
    with pytest.warns(PitchWarning, match=r"\+5\.\d %"):
        rest(0.9, baseline_scale=1.05)


def test_nothing_is_known_before_the_rest_frame() -> None:
    assert Pipeline(Rig.parallel((640, 480), 560.0, 8.0)).pitch_check is None
