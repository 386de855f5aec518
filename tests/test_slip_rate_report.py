"""Held and creeping contacts of `gelstereo_bench.reports.slip_rate`."""

from __future__ import annotations

import numpy as np
import pytest

from gelstereo import Stick
from gelstereo_bench.reports.slip_rate import CREEP, alarms, held


@pytest.mark.parametrize("creep", [0.0, CREEP])
def test_parts_that_stick_raise_no_alarm_in_ten_seconds(creep: float) -> None:
    random = np.random.default_rng(0)
    for contact in held(3, 0, 0.2, creep):
        for step in (*contact.pressing[1:], *contact.steps):
            touching = step.stick[step.stick != Stick.FREE]
            assert len(touching) and np.mean(touching == Stick.STUCK) > 0.9, contact.kind
        assert alarms(contact, random, 10.0, patch_is_known=True) == 0, contact.kind


def test_a_creeping_part_sinks_between_its_computed_frames() -> None:
    (contact,) = held(1, 0, 0.2, CREEP)
    early, late = (contact.at(time_s)[0][:, 2].min() for time_s in (0.0, 11.0))
    between = contact.at(0.5 * (contact.times_s[-2] + contact.times_s[-1]))[0]
    expected = 0.5 * (contact.steps[-2].points_mm + contact.steps[-1].points_mm)
    np.testing.assert_allclose(between, expected, atol=1e-12)
    # Towards the camera: 0.3 to 0.8 mm of a ball, by 3 % for each of two decades.
    assert 0.01 < early - late < 0.06
