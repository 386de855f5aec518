"""A thread repeats: by the pressed markers alone every pitch explains a contact, with the others one does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom

from gelstereo import Localization, Params, Template, localize, parts
from gelstereo.geometry import se3_exp

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

    def on_part_mm(self) -> np.ndarray:
        """The markers in the part's frame."""
        back = np.linalg.inv(self.t_sensor_object)
        return self.points_mm @ back[:3, :3].T + back[:3, 3]

    def slide_mm(self, found: np.ndarray) -> float:
        """How far along the thread a pose is from the truth, less the advance of its turn: a screw motion is
        free.
        """
        moved = np.linalg.inv(self.t_sensor_object) @ found
        turn = np.arctan2(moved[1, 0], moved[0, 0])
        return float(moved[2, 3] - PITCH_MM * turn / (2.0 * np.pi))

    def find(self, template: Template, guess: np.ndarray, method: str, *, every: bool) -> Localization:
        count = int(self.salient.sum())
        return localize(
            self.points_mm[self.salient],
            template,
            guess=guess,
            all_points_mm=self.points_mm if every else None,
            covariance_mm2=np.tile(np.diag([0.25, 0.25, 1.0]) * SIGMA_MM**2, (count, 1, 1)),
            # This gel comes back to rest at once beside the part.
            # Five pitches of 90 points take more than the usual budget.
            params=Params().replace(
                {
                    "register.method": method,
                    "register.surface_search.budget": 1_000_000,
                    "contact.decay_mm": 0.1,
                }
            ),
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


def test_markers_beyond_the_tip_alone_tell_pitches_apart(template: Template) -> None:
    """A pitch farther every pressed marker is as near to the thread as before, and those beyond the tip are
    inside.
    """
    told, runs = 0, 16
    for seed in range(3000, 3000 + runs):
        pressed = press(template, seed)
        here_mm = pressed.on_part_mm()
        near, far = (template.closest(here_mm - [0, 0, z]).distances_mm for z in (0.0, PITCH_MM))
        # Where the surface repeats: nearest points lie neither on the end nor on the head.
        repeats = (here_mm[:, 2] > HEAD_MM + 2.0 * PITCH_MM) & (
            here_mm[:, 2] < HEAD_MM + THREAD_MM - PITCH_MM
        )
        # Some roundings of coordinates up to 40 mm.
        np.testing.assert_allclose(
            near[pressed.salient & repeats], far[pressed.salient & repeats], atol=1e-13
        )
        assert (pressed.salient & repeats).sum() > 0.8 * pressed.salient.sum()
        # A pitch more is 1.5 mm by 6.2 mm, the width 0.1 mm below the crest: 11 markers at rest, some in a
        # groove.
        assert near.min() > -5.0 * SIGMA_MM and (far < -5.0 * SIGMA_MM).sum() >= 3
        one, other = (
            pressed.find(template, slid(pressed, k), "surface_close", every=True) for k in (0.0, 1.0)
        )
        assert abs(pressed.slide_mm(one.t_sensor_object)) < 0.1
        told += one.log_likelihood - other.log_likelihood > KEPT
    # Three markers that can only be outliers cost 3 ln 20, twice ln 100. What is left are steps that end
    # elsewhere.
    assert told >= least(0.99, runs), told


def likely(pressed: Pressed, template: Template, guess: np.ndarray) -> set[int]:
    """The pitches that explain the salient markers alone about as well, the guess counted; from starts at
    each.
    """
    found = {}
    centre = np.append(pressed.points_mm[pressed.salient].mean(axis=0), 1.0)
    for pitches in range(-2, 6):
        turns = (np.array(se3_exp([0, 0, a, 0, 0, PITCH_MM * a / (2.0 * np.pi)])) for a in (-0.06, 0.0, 0.06))
        starts = [slid(pressed, pitches) @ turn for turn in turns]
        ends = [pressed.find(template, start, "surface_close", every=False) for start in starts]
        ends = [end for end in ends if abs(pressed.slide_mm(end.t_sensor_object) / PITCH_MM - pitches) < 0.1]
        # What the guess, known to 2 mm, says; those of the starts say hardly anything.
        far_mm = [
            np.linalg.norm((end.t_sensor_object @ np.linalg.inv(guess) @ centre - centre)[:3]) for end in ends
        ]
        logs = [end.log_likelihood - far**2 / 8.0 for end, far in zip(ends, far_mm, strict=True)]
        found[pitches] = max(logs, default=-np.inf)
    # Steps end where the likelihood is up to 0.4 less than at its top.
    return {k for k, log in found.items() if log > max(found.values()) - (KEPT - 0.4)}


@pytest.mark.long
def test_every_pitch_within_reach_of_the_guess_is_returned_once_and_ranked(template: Template) -> None:
    """Seen in part, a thread's pitches are as likely; with every marker there is one pose (seeds 4000 to
    4039).
    """
    all_returned, right, runs = 0, 0, 40
    for seed in range(4000, 4000 + runs):
        pressed = press(template, seed)
        guess = slid(pressed, 0.5)
        blind = pressed.find(template, guess, "surface_search", every=False)
        poses = [blind.t_sensor_object, *(pose for pose, _ in blind.alternatives)]
        pitches = np.array([pressed.slide_mm(pose) for pose in poses]) / PITCH_MM
        # Each stands at a whole pitch from the truth, towards the tip: on the other side it would not reach
        # as far.
        assert np.abs(pitches - np.round(pitches)).max() < 0.1 and np.round(pitches).min() >= 0, pitches
        whole = {int(k) for k in np.round(pitches)}
        assert len(whole) == len(poses) and not blind.alternatives_cut
        all_returned += likely(pressed, template, guess) <= whole
        ranks = [blind.log_likelihood, *(likelihood for _, likelihood in blind.alternatives)]
        assert ranks == sorted(ranks, reverse=True) and ranks[0] - ranks[-1] <= KEPT
        seeing = pressed.find(template, guess, "surface_search", every=True)
        right += not seeing.alternatives and abs(pressed.slide_mm(seeing.t_sensor_object)) < 0.1 * PITCH_MM
    assert all_returned >= least(0.95, runs) and right >= least(0.95, runs), (all_returned, right)


def test_row_10_a_thread_is_free_to_screw_by_its_pitch(template: Template) -> None:
    """Of six directions one is free, and it is named: a turn about the axis that advances by a
    pitch a turn.
    """
    for seed in range(5000, 5006):
        pressed = press(template, seed)
        for method in ("surface_close", "surface_search"):
            (free,) = pressed.find(template, slid(pressed, 0.0), method, every=False).free
            assert str(free).startswith("screw about z through "), free
            assert np.linalg.norm(free.omega) == pytest.approx(1.0)
            # Faces are a 66th of a turn wide, so their normals are up to pi / 66 off around the axis. Such
            # errors of n markers at 4.5 mm leave 4.5 (pi / 66) / sqrt(3 n) mm per radian, and more by the
            # flanks' tilt of 30 deg.
            off_mm = 4.5 * np.pi / 66.0 / np.sqrt(3.0 * pressed.salient.sum()) / np.cos(np.pi / 6.0)
            pitch_mm = 2.0 * np.pi * float(free.omega @ free.v)
            assert pitch_mm == pytest.approx(PITCH_MM, abs=3.0 * 2.0 * np.pi * off_mm), free
