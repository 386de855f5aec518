"""`lattice.depth_mm` and `skin_over`: the skin over a print below it, on gels solved by finite elements."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from test_rectangular import COLS, ROWS, rest_mm

import gelstereo as gs
from gelstereo.force import PressedSkin, pressed_skin
from outside import judge_skin

RADIUS_MM = 4.5
#: Errors of the law on the development half, um: docs/outside.md.
BOUNDS_UM = {0.2: 6.0, 0.4: 10.0, 0.8: 25.0}


def inner(each: judge_skin.Print) -> np.ndarray:
    return each.away_mm < 0.7 * each.touching_mm


@pytest.mark.parametrize("depth_mm", [0.2, 0.4, 0.8])
def test_the_skin_of_solved_gels_lies_on_the_ball(depth_mm: float) -> None:
    found: dict[str, list[np.ndarray]] = {}
    for each in judge_skin.prints("w"):
        if each.depth_mm == depth_mm:
            for name, points_mm in judge_skin.skins(each).items():
                found.setdefault(name, []).append(each.error_mm(points_mm)[inner(each)])
    rms_um = {name: 1e3 * np.sqrt(np.mean(np.concatenate(off) ** 2)) for name, off in found.items()}
    assert rms_um["skin"] < BOUNDS_UM[depth_mm]
    assert rms_um["constant thickness"] > 3 * rms_um["skin"]
    assert rms_um["markers"] > 500 * depth_mm


def test_stated_variances_cover_the_laws_error() -> None:
    squares = []
    for each in judge_skin.prints("w"):
        rest = gs.RestSurface(each.rest_mm)
        noise = np.tile(1e-6 * np.eye(3), (len(each.rest_mm), 1, 1))
        skin, covariance = gs.skin_over(
            rest, each.points_mm, noise, cols=judge_skin.SIDE, depth_mm=each.depth_mm
        )
        toward = skin - each.ball_mm
        toward /= np.linalg.norm(toward, axis=1)[:, None]
        variance = np.einsum("ni,nij,nj->n", toward, covariance, toward)
        squares.append((each.error_mm(skin) ** 2 / variance)[inner(each)])
    assert 0.1 < np.mean(np.concatenate(squares)) < 1.0


def press(depth_mm: float, lattice_depth_mm: float) -> tuple[gs.Frame, gs.Pipeline, np.ndarray, float]:
    """The last frame of a ball on a gel whose print lies below the skin; the ball's middle and radius."""
    each = [e for e in judge_skin.prints("w") if e.depth_mm == depth_mm and e.radius_mm == RADIUS_MM][8]
    side = judge_skin.SIDE

    def in_sensor(points_mm: np.ndarray) -> np.ndarray:
        # Depth of the skin at rest is 28.7 mm in the sensor frame.
        return points_mm + [4.0, 0.0, 28.7 - (each.rest_mm[0, 2] + depth_mm)]

    gel = {"rows": side, "cols": side, "pitch_mm": judge_skin.PITCH_MM, "dot_radius_mm": 0.2}
    simulator = gs.Simulator(gs.Scene().replace({"gel": gel, "effects.defocus": {}}))
    settings = {"lattice.pitch_mm": judge_skin.PITCH_MM, "lattice.depth_mm": lattice_depth_mm}
    pipeline = gs.Pipeline(gs.Scene().rig, gs.Params.preset("exact").replace(settings))
    for share in np.linspace(0.0, 1.0, 9):
        points_mm = each.rest_mm + share * (each.points_mm - each.rest_mm)
        drawn = simulator.render_points(in_sensor(points_mm))
        frame = pipeline.process(drawn.left, drawn.right)
    return frame, pipeline, in_sensor(each.ball_mm[None])[0], each.radius_mm


@pytest.fixture(scope="module")
def ball() -> gs.Template:
    return gs.Template.from_mesh(trimesh.creation.icosphere(5, RADIUS_MM), units="mm", spacing_mm=0.5)


@pytest.mark.parametrize("depth_mm", [0.2, 0.4])
def test_a_ball_is_located_at_the_skin(depth_mm: float, ball: gs.Template) -> None:
    def off_mm(lattice_depth_mm: float) -> float:
        frame, pipeline, ball_mm, _ = press(depth_mm, lattice_depth_mm)
        guess = np.eye(4)
        guess[:3, 3] = ball_mm + [0.2, -0.1, 0.1]
        found = gs.localize(frame, ball, guess=guess, params=pipeline.params)
        return float(found.t_sensor_object[2, 3] - ball_mm[2])

    # The part seems nearer to the cameras by the depth of the print.
    assert off_mm(0.0) < -0.7 * depth_mm
    assert abs(off_mm(depth_mm)) < 0.03


def test_a_frames_points_are_those_of_the_skin() -> None:
    frame, pipeline, _, _ = press(0.4, 0.4)
    markers, bare, _, _ = press(0.4, 0.0)
    assert pipeline.rest is not None and bare.rest is not None
    down = -np.asarray(bare.rest.normal)
    np.testing.assert_allclose(pipeline.rest.points_mm, bare.rest.points_mm + 0.4 * down, atol=1e-12)
    skin, covariance = gs.skin_over(
        bare.rest, markers.points_mm, markers.covariance_mm2, cols=judge_skin.SIDE, depth_mm=0.4
    )
    np.testing.assert_array_equal(frame.points_mm, skin)
    np.testing.assert_array_equal(frame.covariance_mm2, covariance)
    np.testing.assert_allclose(frame.indentation_mm, pipeline.rest.indentation_mm(skin), atol=1e-12)
    # Contact is found from the markers.
    np.testing.assert_array_equal(frame.salient, markers.salient)


def test_a_resumed_pipeline_gives_the_same_skin() -> None:
    each = next(
        each for each in judge_skin.prints("w") if each.depth_mm == 0.4 and each.radius_mm == RADIUS_MM
    )
    shift = np.array([4.0, 0.0, 28.3 - each.rest_mm[0, 2]])
    side = judge_skin.SIDE
    gel = {"rows": side, "cols": side, "pitch_mm": judge_skin.PITCH_MM, "dot_radius_mm": 0.2}
    simulator = gs.Simulator(gs.Scene().replace({"gel": gel}))
    settings = {"lattice.pitch_mm": judge_skin.PITCH_MM, "lattice.depth_mm": 0.4, "detect.search": "whole"}
    params = gs.Params.preset("balanced").replace(settings)
    first, second = (gs.Pipeline(gs.Scene().rig, params) for _ in range(2))
    rest, pressed = (simulator.render_points(points + shift) for points in (each.rest_mm, each.points_mm))
    first.process(rest.left, rest.right)
    record = first.rest_record()
    assert record is not None
    second.resume(record)
    found = [pipeline.process(pressed.left, pressed.right) for pipeline in (first, second)]
    assert first.rest is not None and second.rest is not None
    np.testing.assert_array_equal(first.rest.points_mm, second.rest.points_mm)
    # A resumed pipeline is good to a micrometre; an area ratio of cells of 1.7 mm adds less than another.
    np.testing.assert_allclose(found[0].indentation_mm, found[1].indentation_mm, atol=2e-3)


def test_lists_that_do_not_fit_are_refused() -> None:
    points_mm = rest_mm((1.0, 1.0))
    rest = gs.RestSurface(points_mm)
    noise = np.zeros((ROWS * COLS, 3, 3))
    with pytest.raises(gs.ContactError, match="194 markers"):
        gs.skin_over(rest, points_mm[1:], noise[1:], cols=COLS, depth_mm=0.4)
    with pytest.raises(ValueError, match="194 matrices for 195 points"):
        gs.skin_over(rest, points_mm, noise[1:], cols=COLS, depth_mm=0.4)
    with pytest.raises(ValueError, match="depth_mm is -1"):
        gs.skin_over(rest, points_mm, noise, cols=COLS, depth_mm=-1.0)
    with pytest.raises(gs.ParamsError, match=r"lattice\.depth_mm is 101; valid is 0 to 100 mm"):
        gs.Params().replace({"lattice.depth_mm": 101.0})


def test_pressure_compresses_the_skin_of_solved_gels() -> None:
    """Neither gel of this half is very compressible; docs/outside.md has others."""
    found: dict[str, list[np.ndarray]] = {"constant": [], "pressed": []}
    for each in judge_skin.prints("w"):
        if each.depth_mm == 0.2:
            for name, points_mm in (
                ("constant", judge_skin.skins(each)["skin"]),
                ("pressed", judge_skin.under_pressure(each)),
            ):
                found[name].append(each.error_mm(points_mm)[inner(each)])
    rms_um = {name: 1e3 * np.sqrt(np.mean(np.concatenate(off) ** 2)) for name, off in found.items()}
    assert rms_um["pressed"] < 4.0
    assert rms_um["pressed"] < 0.8 * rms_um["constant"]


def test_the_skin_under_pressure_of_drawn_images_lies_on_the_ball() -> None:
    frame, pipeline, ball_mm, radius_mm = press(0.2, 0.0)
    assert pipeline.rest is not None
    gel = judge_skin.gels()["a"]
    force = {"method": "bounded", "young_kpa": 1.0}
    force |= {name: gel[name] for name in ("thickness_mm", "poisson_ratio")}
    deep = pipeline.params.replace({"lattice.depth_mm": 0.2}, force=force)
    over = PressedSkin(pipeline.rest, deep, cols=frame.cols, covariance_mm2=frame.covariance_mm2)
    skin, _ = over.run(frame.points_mm, frame.covariance_mm2, frame.patch)
    constant, _ = gs.skin_over(
        pipeline.rest, frame.points_mm, frame.covariance_mm2, cols=frame.cols, depth_mm=0.2
    )
    inside = np.linalg.norm((np.asarray(skin) - ball_mm)[:, :2], axis=1) < 1.5
    assert inside.sum() >= 9

    def rms_mm(points_mm: np.ndarray) -> float:
        off = np.linalg.norm(points_mm - ball_mm, axis=1)[inside] - radius_mm
        return float(np.sqrt(np.mean(off**2)))

    assert rms_mm(skin) < 0.005 and rms_mm(skin) < 0.8 * rms_mm(np.asarray(constant))


def stretched(by: float) -> tuple[gs.RestSurface, np.ndarray, np.ndarray]:
    """A print that is stretched evenly to both sides."""
    points_mm = rest_mm((1.0, 1.0))
    return gs.RestSurface(points_mm), points_mm * [by, by, 1.0], np.zeros((ROWS * COLS, 3, 3))


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45, 0.49])
@pytest.mark.parametrize("pressure", [0.0, 0.2, 1.5])
@pytest.mark.parametrize("by", [0.95, 1.0, 1.2])
def test_an_evenly_stretched_gel_is_in_equilibrium(poisson_ratio: float, pressure: float, by: float) -> None:
    rest, points_mm, nothing = stretched(by)
    skin, _ = pressed_skin(
        rest,
        points_mm,
        nothing,
        np.full(len(points_mm), pressure),
        cols=COLS,
        depth_mm=0.5,
        thickness_mm=4.0,
        poisson_ratio=poisson_ratio,
    )
    distances = np.linalg.norm(skin - points_mm, axis=1)
    assert np.ptp(distances) < 1e-9
    shear, bulk = 0.5 / (1.0 + poisson_ratio), 1.0 / (3.0 * (1.0 - 2.0 * poisson_ratio))

    def energy(across: float) -> float:
        volume = by**2 * across
        invariant = volume ** (-2.0 / 3.0) * (2.0 * by**2 + across**2)
        return float(0.5 * shear * (invariant - 3.0) + 0.25 * bulk * (volume**2 - 1.0 - 2.0 * np.log(volume)))

    across, step = distances[0] / 0.5, 1e-6
    stress = (energy(across + step) - energy(across - step)) / (2.0 * step) / by**2
    assert stress == pytest.approx(-pressure, abs=1e-6)


def test_an_incompressible_gel_keeps_its_volume_under_pressure() -> None:
    rest, points_mm, nothing = stretched(1.1)
    law = {"cols": COLS, "depth_mm": 0.5}
    pressed, covariance = pressed_skin(
        rest, points_mm, nothing, np.full(len(points_mm), 2.0), thickness_mm=4.0, poisson_ratio=0.5, **law
    )
    constant, stated = gs.skin_over(rest, points_mm, nothing, **law)
    np.testing.assert_allclose(pressed, constant, atol=1e-9)
    np.testing.assert_array_equal(covariance, stated)
    on_skin, _ = pressed_skin(
        rest,
        points_mm,
        nothing,
        np.zeros(len(points_mm)),
        cols=COLS,
        depth_mm=0.0,
        thickness_mm=4.0,
        poisson_ratio=0.4,
    )
    np.testing.assert_array_equal(on_skin, points_mm)


def test_settings_without_a_layer_or_pressure_are_refused() -> None:
    rest, points_mm, nothing = stretched(1.0)
    law = {"cols": COLS, "thickness_mm": 4.0, "poisson_ratio": 0.45}
    with pytest.raises(ValueError, match=r"depth_mm is 4\.0; valid is 0 to below the thickness"):
        pressed_skin(rest, points_mm, nothing, np.zeros(len(points_mm)), depth_mm=4.0, **law)
    with pytest.raises(ValueError, match=r"poisson_ratio is 0\.6"):
        pressed_skin(
            rest, points_mm, nothing, np.zeros(len(points_mm)), depth_mm=0.4, **{**law, "poisson_ratio": 0.6}
        )
    for pressure in (np.zeros(3), np.full(len(points_mm), np.nan)):
        with pytest.raises(ValueError, match="one finite number for each of 195 markers"):
            pressed_skin(rest, points_mm, nothing, pressure, depth_mm=0.4, **law)
    with pytest.raises(ValueError, match=r'force\.method is "none"; valid are "ridge" and "bounded"'):
        PressedSkin(rest, gs.Params(), cols=COLS, covariance_mm2=nothing)
    force = {"method": "ridge", "thickness_mm": 3.0, "young_kpa": 1.0}
    deep = gs.Params().replace({"lattice.depth_mm": 3.0}, force=force)
    with pytest.raises(ValueError, match=r"lattice\.depth_mm is 3.0; valid is below force\.thickness_mm"):
        PressedSkin(rest, deep, cols=COLS, covariance_mm2=np.tile(1e-6 * np.eye(3), (len(points_mm), 1, 1)))
