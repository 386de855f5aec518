"""Found poses err as their covariance says: NEES (Bar-Shalom, Li and Kirubarajan 2001, 5.4) over parts in the gel."""

import numpy as np
import pytest
from gelstereo import Params
from gelstereo.frontier.grasps import GRASPED, NOISES, STARTS, Grasp, grasps
from gelstereo.frontier.nees import Nees
from scipy.stats import binom, chi2

#: A right covariance fails a test once in so many runs of fresh seeds.
_RARE = 1e-4
#: Work of a whole search, about: the middle one of three hundred contacts.
_WHOLE = 300_000


@pytest.fixture(scope="module")
def contacts() -> list[Grasp]:
    """Two of every part, with as many kinds of noise; seeds on which nothing was chosen."""
    return [
        grasp
        for k, press in enumerate(GRASPED)
        for noise in (NOISES[k % 3], NOISES[(k + 1) % 3])
        for grasp in grasps(press, noise, range(301, 304))
    ]


def _nees(contacts: list[Grasp], budget: int) -> tuple[Nees, int]:
    """Of the successes, and how many of them ended by themselves."""
    settings = {"method": "surface_search", "search_radius_mm": 8.0, "budget": budget}
    params = Params().replace({"register": settings})
    nees, ended = Nees(), 0
    for seed, grasp in enumerate(contacts):
        found = grasp.registered(grasp.guess(STARTS[0], seed), params)
        if grasp.score(np.asarray(found.t_sensor_object)).success:
            nees.add(found, grasp.t_sensor_object)
            ended += found.converged
    return nees, ended


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 4.0])
def test_successes_lie_within_their_covariance(contacts: list[Grasp], share: float) -> None:
    nees, ended = _nees(contacts, int(share * _WHOLE))
    count = len(nees.squared)
    outside = round(count * (1.0 - 0.01 * nees.within))
    assert count >= len(contacts) // 3
    # One in twenty lies outside where covariances are right.
    assert outside <= binom.isf(_RARE, count, 0.05)
    degrees = sum(nees.directions)
    assert nees.mean <= chi2.isf(_RARE, degrees) / degrees
    if share < 0.3:
        assert ended == 0
    if share > 1.0:
        assert ended >= 0.9 * count
        # And they claim no less than they know: half as large in every direction would be a fourth.
        assert nees.mean > 0.25
