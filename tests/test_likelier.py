"""The simulator's own likelihood of heights: greatest at the truth, and as large as noise makes it
(simulated).
"""

import numpy as np
import pytest

from gelstereo.geometry import se3_exp
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, STARTS, Grasp, grasps, simulator_of
from gelstereo_bench.frontier.likelier import log_likelihood, success_or_likelier


@pytest.fixture(scope="module")
def contacts() -> list[Grasp]:
    return list(grasps(GRASPED[1], NOISES[0], range(3)))


def test_at_the_truth_it_is_what_noise_makes_it(contacts: list[Grasp]) -> None:
    simulator, sigma = simulator_of(contacts[0].mesh), NOISES[0].sigma_mm
    for grasp in contacts:
        count = len(grasp.all_points_mm)
        # -n (ln σ √(2π) + χ²/2), χ² of n degrees over n: five standard deviations of half of it; slopes widen
        # some.
        at_mean = -count * (0.5 + 0.5 * np.log(2.0 * np.pi) + np.log(sigma))
        truth = log_likelihood(grasp, NOISES[0], simulator, grasp.t_sensor_object)
        assert truth == pytest.approx(at_mean, abs=5.0 * np.sqrt(0.5 * count))
        for axis in range(6):
            off = np.zeros(6)
            off[axis] = 0.05 if axis < 3 else 0.5
            moved = grasp.t_sensor_object @ se3_exp(off)
            # Along its own axis a peg may slide where its tip lies off the gel.
            if axis != 5:
                assert log_likelihood(grasp, NOISES[0], simulator, moved) < truth


def test_poses_that_are_neither_right_nor_likelier_count_as_neither(contacts: list[Grasp]) -> None:
    noise = NOISES[0]
    right = [grasp.t_sensor_object for grasp in contacts]
    far = [grasp.guess(STARTS[2], 1) for grasp in contacts]
    assert success_or_likelier(contacts, noise, right) == 100.0
    assert success_or_likelier(contacts, noise, far) == 0.0
    assert success_or_likelier(contacts, noise, [None, *right[1:]]) == pytest.approx(200.0 / 3.0)
