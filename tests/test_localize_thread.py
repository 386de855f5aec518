"""A thread repeats every pitch: without the markers that nothing presses two poses explain a contact, with them one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from gelstereo import Localization, Params, Template, localize, parts
from gelstereo.geometry import se3_exp
from scipy.stats import binom

PITCH_MM, REST_MM, PRESS_MM, SIGMA_MM = 1.5, 28.7, 1.2, 0.02
#: The head is out of sight, as on a bolt that is held by it; the tip is 4 mm off the gel's middle.
THREAD_MM, HEAD_MM, TIP_MM = 30.0, 6.4, 4.0
#: Alternatives are kept down to a hundredth of the likelihood.
KEPT = float(np.log(100.0))


@dataclass(frozen=True)
class Pressed:
    """A thread across the gel and every marker, sensor frame, mm."""

    t_sensor_object: np.ndarray
    points_mm: np.ndarray
    salient: np.ndarray

    def slide_mm(self, found: np.ndarray) -> float:
        """How far along the thread a pose is from the truth, less the advance of its turn: a screw motion is free."""
        moved = np.linalg.inv(self.t_sensor_object) @ found
        turn = np.arctan2(moved[1, 0], moved[0, 0])
        return float(moved[2, 3] - PITCH_MM * turn / (2.0 * np.pi))

    def find(self, template: Template, guess: np.ndarray, method: str, *, every: bool) -> Localization:
        count = int(self.salient.sum())
        return localize(
            self.points_mm[self.salient],
            template,
            t_sensor_object=guess,
            all_points_mm=self.points_mm if every else None,
            covariance_mm2=np.tile(np.diag([0.25, 0.25, 1.0]) * SIGMA_MM**2, (count, 1, 1)),
            # This gel comes back to rest at once beside the part.
            params=Params().replace({"register.method": method, "contact.decay_mm": 0.1}),
        )


@pytest.fixture(scope="module")
def template() -> Template:
    return Template.from_mesh(parts.screw_m10(THREAD_MM), units="mm", spacing_mm=0.3)


def press(template: Template, seed: int) -> Pressed:
    rng = np.random.default_rng(seed)
    yaw, roll = rng.uniform(0.0, 2.0 * np.pi, 2)
    lying = se3_exp([0, np.pi / 2, 0, 0, 0, 0])
    pose = np.array(se3_exp([0, 0, yaw, 0, 0, 0]) @ lying @ se3_exp([0, 0, roll, 0, 0, 0]))
    pose[:2, 3] = -pose[:2, 2] * (HEAD_MM + THREAD_MM - TIP_MM)
    pose[2, 3] = REST_MM - PRESS_MM + 5.0
    grid = np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)), -1).reshape(-1, 2) * 0.9
    points = np.column_stack([grid, np.full(len(grid), REST_MM - 2.0 * PRESS_MM)])
    # Towards the part by the distance that is free, until it is met (Hart 1996).
    back = np.linalg.inv(pose)
    for _ in range(200):
        free = template.closest(points @ back[:3, :3].T + back[:3, 3]).distances_mm
        points[:, 2] = np.minimum(points[:, 2] + np.maximum(free, 0.0), REST_MM)
    salient = points[:, 2] < REST_MM - 0.1
    points += SIGMA_MM * rng.normal(size=points.shape) * [0.5, 0.5, 1.0]
    return Pressed(pose, points, salient)


def slid(pressed: Pressed, pitches: float) -> np.ndarray:
    return np.asarray(pressed.t_sensor_object @ se3_exp([0, 0, 0, 0, 0, pitches * PITCH_MM]))


def least(claimed: float, runs: int) -> int:
    """Successes that a claimed probability falls short of once in a thousand times."""
    return int(binom.ppf(1e-3, runs, claimed))


def test_a_pitch_farther_is_as_likely_until_markers_beyond_the_tip_are_given(template: Template) -> None:
    """Nine contacts in ten: the rest of them noise decides."""
    alike, told, runs = 0, 0, 24
    for seed in range(runs):
        pressed = press(template, seed)
        for every in (False, True):
            here, beyond = (
                pressed.find(template, slid(pressed, pitches), "surface_close", every=every)
                for pitches in (0.0, 1.0)
            )
            assert abs(pressed.slide_mm(here.t_sensor_object)) < 0.1
            lead = here.log_likelihood - beyond.log_likelihood
            told += every and lead > KEPT
            alike += not every and abs(lead) < KEPT
    assert told >= least(0.99, runs) and alike >= least(0.9, runs), (told, alike)


def test_poses_pitches_apart_are_returned_and_every_marker_tells_which(template: Template) -> None:
    """Every pose that is returned is a whole pitch off; four times in five another pitch is among them.

    Otherwise poses along the free turn, which are no other, stand where the other pitch should.
    """
    several, right, runs = 0, 0, 16
    for seed in range(runs):
        pressed = press(template, seed)
        guess = slid(pressed, 0.5)
        blind = pressed.find(template, guess, "surface_search", every=False)
        poses = [blind.t_sensor_object, *(pose for pose, _ in blind.alternatives)]
        pitches = np.array([pressed.slide_mm(pose) for pose in poses]) / PITCH_MM
        # Each stands at a whole pitch from the truth, towards the tip: on the other side it would not reach as far.
        assert np.abs(pitches - np.round(pitches)).max() < 0.1 and np.round(pitches).min() >= 0, pitches
        several += len(set(np.round(pitches))) > 1
        ranks = [blind.log_likelihood, *(likelihood for _, likelihood in blind.alternatives)]
        assert ranks == sorted(ranks, reverse=True)
        seeing = pressed.find(template, guess, "surface_search", every=True)
        found = [seeing.t_sensor_object, *(pose for pose, _ in seeing.alternatives)]
        right += all(abs(pressed.slide_mm(pose)) < 0.1 * PITCH_MM for pose in found)
    assert several >= least(0.8, runs) and right >= least(0.95, runs), (several, right)
