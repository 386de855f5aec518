"""`localize` and `Localizer` on a frame: the same as with all that a frame has, handed over by hand."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import gelstereo as gs
from gelstereo.geometry import se3_exp, se3_log

SCENES = Path(__file__).parents[1] / "scenes"
PARAMS = gs.Params.preset("balanced")


@pytest.fixture(scope="module")
def grasp() -> tuple[gs.Frame, gs.Template, np.ndarray]:
    """The last frame of a grasped cylinder, its template, and a guess."""
    sensor = gs.simulate("grasp_cylinder")
    pipeline = gs.Pipeline(sensor.scene.rig, PARAMS)
    for pair in sensor:
        frame = pipeline.process(pair.left, pair.right)
    part = {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 20.0}
    template = gs.Template.from_triangles(*gs.geometry.shape_mesh(part))
    assert pair.t_sensor_object is not None
    return frame, template, pair.t_sensor_object @ se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])


def by_hand(frame: gs.Frame) -> dict[str, np.ndarray]:
    return {
        "all_points_mm": frame.points_mm[(frame.state == gs.MarkerState.SEEN) | frame.patch],
        "covariance_mm2": frame.covariance_mm2[frame.patch],
    }


@pytest.mark.parametrize("method", ["surface_search", "surface_close", "filterreg_point", "ransac_icp"])
def test_a_frame_hands_over_all_that_it_has(
    grasp: tuple[gs.Frame, gs.Template, np.ndarray], method: str
) -> None:
    frame, template, guess = grasp
    params = PARAMS.replace({"register.method": method})
    found = gs.localize(frame, template, guess=guess, params=params)
    same = gs.localize(frame.patch_points_mm, template, guess=guess, params=params, **by_hand(frame))
    assert found.digest == same.digest
    assert found.model == {"surface_search": "gel", "surface_close": "surface"}.get(method, "samples")
    assert pickle.loads(pickle.dumps(found)).model == found.model


def test_a_localizer_takes_frames(grasp: tuple[gs.Frame, gs.Template, np.ndarray]) -> None:
    frame, template, guess = grasp
    one, other = (gs.Localizer(template, guess=guess, params=PARAMS) for _ in range(2))
    for _ in range(2):
        found = one.process(frame)
        assert found.digest == other.process(frame.patch_points_mm, **by_hand(frame)).digest
    assert found.tracking == "tracking" and found.model == "gel"


def test_the_patch_alone_says_that_the_gel_was_left_out(
    grasp: tuple[gs.Frame, gs.Template, np.ndarray],
) -> None:
    frame, template, guess = grasp
    alone = gs.localize(frame.patch_points_mm, template, guess=guess, params=PARAMS)
    assert alone.model == "surface"


def test_a_frame_with_points_beside_it_is_refused(grasp: tuple[gs.Frame, gs.Template, np.ndarray]) -> None:
    frame, template, guess = grasp
    for extra in ("all_points_mm", "covariance_mm2"):
        with pytest.raises(TypeError, match="a Frame has both: leave them out"):
            gs.localize(frame, template, guess=guess, **{extra: by_hand(frame)[extra]})


def test_sigma_is_that_of_a_point_of_the_part(grasp: tuple[gs.Frame, gs.Template, np.ndarray]) -> None:
    """Beside poses drawn from the covariance: T_true = exp(ω, v) T."""
    frame, template, guess = grasp
    found = gs.localize(frame, template, guess=guess, params=PARAMS)
    for point in ([0.0, 0.0, 0.0], [3.0, -2.0, 10.0]):
        draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), found.covariance / 1e4, 4000)
        moved = [(se3_exp(draw) @ found.t_sensor_object @ [*point, 1.0])[:3] for draw in draws]
        turned = [se3_log(se3_exp(draw))[:3] for draw in draws]
        drawn = 100 * np.hstack([np.std(turned, axis=0), np.std(moved, axis=0)])
        # 4000 draws know a deviation to 1.1 %.
        np.testing.assert_allclose(found.sigma_at(point), drawn, rtol=0.06)
    assert np.array_equal(found.sigma_at(), found.sigma_at([0.0, 0.0, 0.0]))
    with pytest.raises(gs.ShapeError):
        found.sigma_at([1.0, 2.0])


def test_scenes_have_names() -> None:
    assert (
        gs.simulate("press_sphere").scene.to_toml() == gs.Scene.load(SCENES / "press_sphere.toml").to_toml()
    )
    with pytest.raises(
        gs.SceneError, match="no scene 'press_cube' comes with gelstereo; valid is one of board_0_8"
    ):
        gs.simulate("press_cube")
