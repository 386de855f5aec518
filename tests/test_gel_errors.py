"""Uncertain numbers of the gel are in the covariances: depth of the print, thickness, Poisson's ratio."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

import gelstereo as gs
from gelstereo.setup.run import learned_settings
from outside import judge_skin

Array = npt.NDArray[np.float64]

SIDE, PITCH_MM, THICKNESS_MM, NU = 15, 0.9, 3.0, 0.47
SIGMA_MM = np.array([0.0015, 0.0015, 0.005])


def loaded(seed: int) -> tuple[Array, Array, list[bool]]:
    """Markers at rest and under a bell of pressure with shear, with noise, and those in contact."""
    rng = np.random.default_rng(seed)
    along = PITCH_MM * (np.arange(SIDE) - SIDE // 2)
    x, y = np.meshgrid(along, along)
    bell = np.sqrt(np.maximum(1.0 - (x**2 + y**2) / 2.6**2, 0.0))
    layer = gs.LayerContact(
        thickness_mm=THICKNESS_MM, poisson_ratio=NU, rows=SIDE, cols=SIDE, cell_mm=PITCH_MM, friction=1.0
    )
    motion = layer.load(0.08 * bell, 0.01 * bell[..., None] * rng.normal(size=2)).motion_mm
    rest = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)])
    moved = rest + np.reshape(motion, (-1, 3)) * [1, 1, -1] + rng.normal(size=rest.shape) * SIGMA_MM
    return rest, moved, (bell > 0).ravel().tolist()


def wrench(rest: Array, moved: Array, patch: list[bool], **force: float) -> gs.Wrench:
    given = {"thickness_mm": THICKNESS_MM, "poisson_ratio": NU, **force}
    params = gs.Params().replace(force={"method": "ridge", "young_kpa": 1000.0, **given})
    none = np.tile(np.eye(3) * 1e-14, (len(rest), 1, 1))
    estimator = gs.ForceEstimator(gs.RestSurface(rest), params, cols=SIDE, covariance_mm2=none)
    found = estimator.run(moved, np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1)), patch)[1]
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("number", "sigma", "value"),
    [("thickness_mm", "thickness_sigma_mm", 0.2), ("poisson_ratio", "poisson_sigma", 0.01)],
)
def test_a_wrench_has_the_error_of_a_number_of_the_gel(number: str, sigma: str, value: float) -> None:
    """What is added is the outer product of the wrench's change, which is measured by other numbers."""
    contact = loaded(0)
    step = 0.1 * value
    nominal = {"thickness_mm": THICKNESS_MM, "poisson_ratio": NU}[number]
    ends = [wrench(*contact, **{number: nominal + side * step}) for side in (-1, 1)]
    low, high = (np.concatenate([each.force_n, each.torque_nmm]) for each in ends)
    change = (high - low) / (2 * step) * value
    added = wrench(*contact, **{sigma: value}).covariance - wrench(*contact).covariance
    # The weights of the prior are chosen anew at each end, and kept in the derivative.
    scale = np.sqrt(np.outer(np.diag(added), np.diag(added)))
    assert np.abs(added - np.outer(change, change))[:3, :3].max() < 0.1 * scale[2, 2]
    assert added[2, 2] > 0.4 * wrench(*contact).covariance[2, 2]


def test_drawn_gels_have_the_stated_error_of_the_force() -> None:
    """Thickness and Poisson's ratio are drawn from what is stated: the squared error is 1 in the mean."""
    rng, squares = np.random.default_rng(1), []
    sigmas = {"thickness_sigma_mm": 0.15, "poisson_sigma": 0.006}
    contact = loaded(2)
    right = wrench(*contact)
    for _ in range(60):
        numbers = {
            "thickness_mm": THICKNESS_MM + 0.15 * rng.normal(),
            "poisson_ratio": min(NU + 0.006 * rng.normal(), 0.5),
        }
        found = wrench(*contact, **numbers, **sigmas)
        own = wrench(*contact, **numbers)
        off = found.force_n[2] - right.force_n[2]
        squares.append(off**2 / (found.covariance[2, 2] - own.covariance[2, 2]))
    # Three standard deviations of the mean of 60 squares are 0.55.
    assert 0.5 < np.mean(squares) < 1.5


def test_a_drawn_depth_of_the_print_is_in_the_covariance_of_the_pose() -> None:
    """A ball pressed into a gel solved by finite elements, with settings off the print's depth."""
    radius_mm, sigma_mm = 4.5, 0.08
    each = [e for e in judge_skin.prints("w") if e.depth_mm == 0.4 and e.radius_mm == radius_mm][8]
    ball = gs.Template.from_mesh(trimesh.creation.icosphere(4, radius_mm), units="mm", spacing_mm=0.6)
    rng, squares, without = np.random.default_rng(5), [], []
    rest = gs.RestSurface(each.rest_mm)
    touching = each.away_mm < 0.9 * each.touching_mm
    noise = np.tile(np.diag([0.002, 0.002, 0.005]) ** 2, (len(each.rest_mm), 1, 1))
    guess = np.eye(4)
    guess[:3, 3] = each.ball_mm + [0.1, -0.1, 0.1]
    for _ in range(16):
        depth_mm = 0.4 + sigma_mm * rng.normal()
        measured = each.points_mm + rng.normal(size=each.points_mm.shape) * [0.002, 0.002, 0.005]
        for depth_sigma_mm, into in ((sigma_mm, squares), (0.0, without)):
            depth = {"depth_mm": depth_mm, "depth_sigma_mm": depth_sigma_mm}
            skin, covariance = gs.skin_over(rest, measured, noise, cols=judge_skin.SIDE, **depth)
            found = gs.localize(
                skin[touching],
                ball,
                guess=guess,
                all_points_mm=skin,
                covariance_mm2=covariance[touching],
                params=gs.Params.preset("exact").replace({"lattice.depth_sigma_mm": depth_sigma_mm}),
            )
            off = found.t_sensor_object[2, 3] - each.ball_mm[2]
            into.append((off / found.sigma_at(each.ball_mm)[5]) ** 2)
    # Three standard deviations of the mean of 16 squares are 1.06.
    assert np.mean(squares) < 2.1 and np.mean(without) > 5.0, (np.mean(squares), np.mean(without))
    assert np.mean(squares) > 0.3


def test_a_drawn_shoulder_is_in_the_covariance_of_the_pose() -> None:
    """The decay length is fitted with the pose, so that a nominal one that is off moves no pose."""
    radius_mm, decay_mm = 5.0, 2.5
    scene = gs.Scene().replace(
        {
            "gel": {"thickness_mm": 2.0 * decay_mm},
            "indenter": {"kind": "sphere", "radius_mm": radius_mm},
            "effects": {"shoulder": {"decay_thicknesses": 0.5}},
        }
    )
    simulator = gs.Simulator(scene)
    rest = gs.RestSurface(simulator[0].points_mm)
    above = np.eye(4)
    above[:3, 3] = [4.2, 0.3, 40.0]
    centre_mm = simulator.pressed(above, 0.9)[:3, 3]
    points = np.asarray(simulator.press(simulator.pressed(above, 0.9)).points_mm)
    # Triangles of a coarser ball lie micrometres inside it.
    ball = gs.Template.from_mesh(trimesh.creation.icosphere(6, radius_mm), units="mm", spacing_mm=0.6)
    noise = np.tile(np.diag(SIGMA_MM**2), (len(points), 1, 1))
    guess = np.eye(4)
    guess[:3, 3] = centre_mm + [0.1, -0.1, 0.1]
    rng, squares, fitted = np.random.default_rng(5), [], []
    for _ in range(24):
        # The prior of the length is a third of it.
        nominal_mm = decay_mm * np.exp(rng.normal() / 3.0)
        measured = points + rng.normal(size=points.shape) * SIGMA_MM
        variance = np.full(len(points), SIGMA_MM[2] ** 2)
        salient, _ = gs.pressure_saliency(
            rest, rest.indentation_mm(measured), variance, rows=25, cols=25, decay_mm=decay_mm
        )
        found = gs.localize(
            measured[salient],
            ball,
            guess=guess,
            all_points_mm=measured,
            covariance_mm2=noise[salient],
            params=gs.Params.preset("exact").replace({"contact.decay_mm": nominal_mm}),
        )
        off_mm = found.t_sensor_object[2, 3] - centre_mm[2]
        squares.append((off_mm / found.sigma_at(np.zeros(3))[5]) ** 2)
        fitted.append(found.gel_decay_mm)
    # Three standard deviations of the mean of 24 squares are 0.87.
    assert 0.3 < np.mean(squares) < 1.9, np.mean(squares)
    # Where the nominal length is far too long, the fit may end at a long one, too.
    right = np.abs(np.array(fitted) / decay_mm - 1.0) < 0.1
    assert right.sum() >= 21, fitted


def test_a_frame_states_the_error_that_its_points_share() -> None:
    scene = gs.Scene()
    params = gs.Params.preset("fast").replace({"lattice.depth_sigma_mm": 0.1})
    pair = gs.Simulator(scene)[0]
    frame = gs.Pipeline(scene.rig, params).process(pair.left, pair.right)
    bare = gs.Pipeline(scene.rig, gs.Params.preset("fast")).process(pair.left, pair.right)
    assert frame.offset_sigma_mm == 0.1 and bare.offset_sigma_mm == 0.0
    np.testing.assert_allclose(frame.points_mm, bare.points_mm, atol=1e-12)
    with pytest.raises(gs.ParamsError, match=r"lattice\.depth_sigma_mm is 101; valid is 0 to 100 mm"):
        gs.Params().replace({"lattice.depth_sigma_mm": 101.0})


def test_a_setup_writes_what_it_learned_with_its_error() -> None:
    gel = {
        "learned": ["decay_mm", "depth_mm", "thickness_mm", "friction"],
        **{"decay_mm": 2.1, "decay_sigma_mm": 0.02, "depth_mm": 0.4, "depth_sigma_mm": 0.1},
        **{"thickness_mm": 4.0, "thickness_sigma_mm": 0.3, "friction": 0.6, "friction_sigma": 0.1},
    }
    found = learned_settings(gel)
    assert found == {
        "contact.decay_mm": 2.1,
        **{"lattice.depth_mm": 0.4, "lattice.depth_sigma_mm": 0.1},
        **{"force.thickness_mm": 4.0, "force.thickness_sigma_mm": 0.3},
        **{"force.friction": 0.6, "force.friction_sigma": 0.1},
    }
    gs.Params().replace(found)
    # A depth that may be none is none, and its error includes what was found.
    shallow = learned_settings({"learned": ["depth_mm"], "depth_mm": 0.12, "depth_sigma_mm": 0.09})
    assert shallow == {"lattice.depth_sigma_mm": pytest.approx(0.15)}
    assert learned_settings({"learned": []}) == {}
