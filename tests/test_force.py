"""Forces: against an independent solution in NumPy, finite elements, and the simulated sensor."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import tamaas
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import gelstereo as gs
from gelstereo_bench.reports import forces
from outside.judge_force import cases

Array = npt.NDArray[np.float64]

SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
ROWS, PITCH_MM = 17, 0.9


def kernels(thickness_mm: float, nu: float) -> tuple[dict[str, Array], float]:
    """Motion at offsets of a quarter pitch for a traction of one modulus on a square of one pitch.

    From the closed forms of an elastic layer in the Fourier domain, on a period of 115 mm.
    """
    step, side = PITCH_MM / 4, 512
    wave = 2 * np.pi * np.fft.fftfreq(side, step)
    kx, ky = np.meshgrid(wave, wave)
    k = np.hypot(kx, ky)
    k[0, 0] = 1e-6
    x = np.minimum(k * thickness_mm, 40.0)
    scale = 2 * (1 - nu**2) / k
    determinant = (3 - 4 * nu) * np.cosh(2 * x) + 2 * x**2 + 5 - 12 * nu + 8 * nu**2
    normal = scale * ((3 - 4 * nu) * np.sinh(2 * x) - 2 * x) / determinant
    along = scale * ((3 - 4 * nu) * np.sinh(2 * x) + 2 * x) / determinant
    across = 2 * (1 + nu) * np.tanh(x) / k
    cross = scale * (x**2 - (1 - 2 * nu) * (3 - 4 * nu) * np.sinh(x) ** 2) / (1 - nu) / determinant
    cell = np.sinc(kx * PITCH_MM / 2 / np.pi) * np.sinc(ky * PITCH_MM / 2 / np.pi) * 16
    c, s = kx / k, ky / k
    spectra = {
        "zz": normal,
        "zx": 1j * cross * c,
        "zy": 1j * cross * s,
        "xz": -1j * cross * c,
        "yz": -1j * cross * s,
        "xx": along * c**2 + across * s**2,
        "yy": along * s**2 + across * c**2,
        "xy": (along - across) * c * s,
        "yx": (along - across) * c * s,
    }
    return {name: np.real(np.fft.ifft2(each * cell)) for name, each in spectra.items()}, step


def influence(places: Array, cells: Array, thickness_mm: float, nu: float) -> Array:
    """(3 markers, 3 cells) matrix; into the layer, along x, along y."""
    found, step = kernels(thickness_mm, nu)
    apart = np.rint((places[:, None] - cells[None]) / step).astype(int)
    matrix = np.zeros((len(places), 3, len(cells), 3))
    for row, to in enumerate("zxy"):
        for col, of in enumerate("zxy"):
            matrix[:, row, :, col] = found[to + of][apart[..., 1], apart[..., 0]]
    return matrix.reshape(3 * len(places), 3 * len(cells))


def most_probable(matrix: Array, motion: Array) -> tuple[Array, Array]:
    """Tractions and their covariance at the largest evidence of whitened motion, by a general search."""
    size = matrix.shape[1]
    pressures = np.arange(size) % 3 == 0

    def posterior(logs: Array) -> tuple[Array, Array, float]:
        prior = np.where(pressures, np.exp(logs[0]), np.exp(logs[1]))
        noise = np.exp(logs[2])
        precision = matrix.T @ matrix / noise + np.diag(1 / prior)
        covariance = np.linalg.inv(precision)
        x = covariance @ matrix.T @ motion / noise
        left = np.sum((motion - matrix @ x) ** 2) / noise + np.sum(x**2 / prior)
        log_determinant = np.linalg.slogdet(precision)[1] + np.log(prior).sum()
        return x, covariance, 0.5 * (left + log_determinant + len(motion) * np.log(noise))

    best = minimize(
        lambda logs: posterior(logs)[2],
        np.log([0.01, 0.001, 1.0]),
        method="L-BFGS-B",
        bounds=[(-27, 5), (-27, 5), (0.0, 12)],
    )
    x, covariance, _ = posterior(best.x)
    return x, covariance


def estimator(rest: Array, thickness_mm: float, nu: float, **more: Any) -> gs.ForceEstimator:
    force = {"method": "ridge", "thickness_mm": thickness_mm, "young_kpa": 1000.0, "poisson_ratio": nu}
    params = gs.Params().replace(force={**force, **more})
    none = np.tile(np.eye(3) * 1e-14, (len(rest), 1, 1))
    return gs.ForceEstimator(gs.RestSurface(rest), params, cols=ROWS, covariance_mm2=none)


def lattice() -> Array:
    along = PITCH_MM * (np.arange(ROWS) - ROWS // 2)
    x, y = np.meshgrid(along, along)
    return np.column_stack([x.ravel(), y.ravel(), np.full(ROWS**2, 30.0)])


@settings(max_examples=4)
@given(
    seed=st.integers(0, 2**31),
    thickness_mm=st.floats(2.0, 4.0),
    nu=st.floats(0.4, 0.495),
    radius_mm=st.floats(1.2, 2.4),
)
def test_the_force_is_that_of_the_largest_evidence(
    seed: int, thickness_mm: float, nu: float, radius_mm: float
) -> None:
    """The reference shares no code: another kernel, another search, plain linear algebra."""
    rng = np.random.default_rng(seed)
    rest = lattice()
    far = np.hypot(*rest[:, :2].T)
    patch = far < radius_mm
    grid = patch.reshape(ROWS, ROWS)
    loaded = np.zeros_like(grid)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            loaded |= np.roll(grid, (down, right), (0, 1))
    cells = rest[loaded.ravel(), :2]
    bell = np.sqrt(np.maximum(1 - (np.hypot(*cells.T) / (radius_mm + 0.5)) ** 2, 0))
    tractions = np.column_stack([0.05 * bell, 0.01 * bell * rng.normal(), 0.01 * bell * rng.normal()])
    matrix = influence(rest[:, :2], cells, thickness_mm, nu)
    into, x, y = (matrix @ tractions.ravel()).reshape(-1, 3).T
    noise = rng.normal(size=rest.shape) * SIGMA_MM
    moved = rest + np.column_stack([x, y, -into]) + noise

    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    _, wrench = estimator(rest, thickness_mm, nu).run(moved, covariance, patch.tolist())
    assert wrench is not None and wrench.cells == len(cells)

    # The same markers: those up to one thickness from a cell, in whole pitches.
    apart = np.rint((rest[:, None, :2] - cells[None]) / PITCH_MM)
    near = np.hypot(*apart.transpose(2, 0, 1)).min(axis=1) <= thickness_mm / PITCH_MM
    assert wrench.markers == near.sum()
    motion = (moved - rest)[near][:, [2, 0, 1]] * [-1, 1, 1] / SIGMA_MM[[2, 0, 1]]
    whitened = influence(rest[near, :2], cells, thickness_mm, nu).reshape(-1, 3, 3 * len(cells))
    whitened = whitened / SIGMA_MM[[2, 0, 1]][None, :, None]
    found, found_covariance = most_probable(whitened.reshape(-1, 3 * len(cells)), motion.ravel())
    # 1000 kPa are 1 N/mm².
    total = np.tile(np.eye(3), (len(cells), 1)) * PITCH_MM**2
    force = found @ total
    sigma = np.sqrt(np.diag(total.T @ found_covariance @ total))
    # The search ends within 5 % of the best variances, which moves the force by less than half of its noise;
    # the reference's kernel is sampled at quarters of a cell, which costs up to 1 %.
    off = np.abs(force - wrench.force_n[[2, 0, 1]] * [-1, 1, 1])
    assert np.all(off < 0.5 * sigma + 0.01 * np.linalg.norm(force))
    assert np.all(sigma < np.sqrt(np.diag(wrench.covariance))[[2, 0, 1]] * 1.1)


def test_forces_of_gels_solved_by_finite_elements() -> None:
    """The development half. docs/force.md has the held-out one; bounds are a third above what was found."""
    found = list(cases("w"))
    assert len(found) > 250
    usual = [case for case in found if case.touching >= 4 and case.strain <= 0.2]
    assert np.sqrt(np.mean([case.pressing_error**2 for case in usual])) < 0.06
    assert np.sqrt(np.mean([case.pressing_error**2 for case in found])) < 0.092
    assert np.sqrt(np.mean([case.shear_error**2 for case in found])) < 0.01
    # Three components: between half and one and a half times what is right.
    assert 1.5 < np.mean([case.squared for case in found]) < 4.5
    # Two; 2.7 if pressures were uniform on their cells.
    assert 0.9 < np.mean([case.tilt_squared for case in found]) < 2.0


def test_the_covariance_grows_by_the_stated_error_of_a_strained_gel() -> None:
    rest = lattice()
    far = np.hypot(*rest[:, :2].T)
    into = 0.4 * np.exp(-((far / 1.5) ** 2))
    moved = rest + np.column_stack([0.05 * into, 0.0 * into, -into])
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    found = []
    for strain_sigma in (0.0, 0.2, 0.4):
        made = estimator(rest, 3.0, 0.48, strain_sigma=strain_sigma)
        found.append(made.run(moved, covariance, (far < 1.5).tolist())[1])
    linear, usual, wide = (np.asarray(wrench.covariance)[:3, :3] for wrench in found)
    force = np.asarray(found[0].force_n)
    pressing, shear = np.array([0.0, 0.0, force[2]]), np.array([force[0], force[1], 0.0])
    share = 0.2 * into.max() / 3.0
    expected = share**2 * (np.outer(pressing, pressing) + np.outer(shear, shear))
    np.testing.assert_allclose(usual - linear, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(wide - linear, 4.0 * expected, rtol=1e-9, atol=1e-12)


def test_torques_of_uneven_pressures_are_within_their_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Balls, plates and cylinders on a fine grid, with a fifth of the usual noise. The normalised squared
    error of the torque along the gel would be 18 if pressures were uniform on their cells.
    """
    monkeypatch.setattr(forces, "_SIGMA_MM", forces._SIGMA_MM / 5)
    squared = []
    for contact in forces.contacts(18, 12):
        gel = {"thickness_mm": contact.thickness_mm, "poisson_ratio": contact.poisson_ratio}
        _, wrench = forces._sensed(contact, {"method": "ridge", "young_kpa": 100.0, **gel})
        error = wrench.torque_nmm[:2] - contact.wrench[3:5]
        squared.append(error @ np.linalg.solve(wrench.covariance[3:5, 3:5], error))
    assert 0.5 < np.mean(squared) < 4.0


@pytest.mark.parametrize(("radius_mm", "force_n"), [(3.0, 2.0), (6.0, 5.0), (10.0, 4.0)])
def test_a_thick_gel_is_the_half_space_of_tamaas(radius_mm: float, force_n: float) -> None:
    """A ball pressed with a known force into an incompressible half-space of 1 N/mm² (boundary elements). Its
    surface does not move sideways. Squares of one pitch cost up to 2 % of the force.
    """
    cell, count = PITCH_MM / 6, 150
    along = (np.arange(count) - count // 2) * cell
    x, y = np.meshgrid(along, along)
    ball = radius_mm - np.sqrt(np.maximum(radius_mm**2 - x**2 - y**2, 0.0))
    model = tamaas.ModelFactory.createModel(tamaas.model_type.basic_2d, [count * cell] * 2, [count] * 2)
    model.E, model.nu = 1.0, 0.5
    tamaas.ModelFactory.registerNonPeriodic(model, "open")
    solver = tamaas.PolonskyKeerRey(model, np.ascontiguousarray(-ball), 1e-12)
    solver.setIntegralOperator("open")
    solver.solve(force_n / (count * cell) ** 2)
    pressure = np.asarray(model.traction).reshape(count, count)
    assert pressure.sum() * cell**2 == pytest.approx(force_n, rel=1e-6)
    # The solver leaves out a rigid motion. In the corner, the sum of Boussinesq's point forces is exact.
    far = np.hypot(x - x[0, 0], y - y[0, 0])
    corner = (pressure[pressure > 0] / far[pressure > 0]).sum() * cell**2 * (1 - 0.5**2) / np.pi
    motion = np.asarray(model.displacement).reshape(count, count)
    motion = motion - motion[0, 0] + corner

    # Markers on every sixth cell; the middle one lies under the ball.
    picked = count // 2 + 6 * (np.arange(ROWS) - ROWS // 2)
    into = motion[np.ix_(picked, picked)].ravel()
    rest = lattice()
    moved = rest - np.column_stack([0 * into, 0 * into, into])
    patch = (pressure[np.ix_(picked, picked)] > 0).ravel()
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    _, wrench = estimator(rest, 500.0, 0.5).run(moved, covariance, patch.tolist())
    assert wrench is not None
    assert -wrench.force_n[2] == pytest.approx(force_n, rel=0.02)
    assert np.hypot(*wrench.force_n[:2]) < 0.01 * force_n


@pytest.fixture(scope="module")
def pressed() -> tuple[gs.Frame, gs.SimulatedFrame]:
    scene = gs.Scene().replace(
        indenter={"kind": "sphere", "radius_mm": 4.0},
        effects={"elastic_layer": {"young_kpa": 120.0, "friction": 0.2}, "sensor_noise": {}},
    )
    sensor = gs.Simulator(scene)
    force = {"method": "bounded", "thickness_mm": 5.0, "young_kpa": 120.0, "friction": 0.2}
    pipeline = gs.Pipeline(scene.rig, gs.Params.preset("balanced").replace(force=force))
    pose = np.eye(4)
    pose[:3, 3] = 4.0, 0.5, 40.0
    assert pipeline.process(sensor[0].left, sensor[0].right).wrench is None
    press = sensor.press(sensor.pressed(pose, 0.9), shear_mm=(0.12, -0.09), frame=1)
    return pipeline.process(press.left, press.right), press


def test_a_frame_has_the_force_of_the_simulated_part(
    pressed: tuple[gs.Frame, gs.SimulatedFrame],
) -> None:
    """Through images, detection and triangulation: within 2 % of the pressing force."""
    frame, press = pressed
    assert frame.wrench is not None and press.loads is not None
    off = frame.wrench.force_n - press.loads.force_n
    assert np.linalg.norm(off) < 0.02 * abs(press.loads.force_n[2])
    moved = frame.wrench.about(press.loads.about_mm)
    error = np.concatenate([off, moved.torque_nmm - press.loads.torque_nmm])
    # 22.5 is the 99.9 % point of chi squared with six degrees of freedom.
    assert error @ np.linalg.solve(moved.covariance, error) < 22.5
    assert np.all(frame.traction_kpa[:, 2] <= 1e-9), "towards the camera, which is -z"
    assert np.linalg.norm(frame.traction_kpa.sum(axis=0)) > 0


def test_a_frame_with_a_wrench_pickles(pressed: tuple[gs.Frame, gs.SimulatedFrame]) -> None:
    frame, press = pressed
    again = pickle.loads(pickle.dumps(frame))
    assert again.digest == frame.digest and again.wrench is not None and frame.wrench is not None
    np.testing.assert_array_equal(again.wrench.covariance, frame.wrench.covariance)
    assert repr(again.wrench) == repr(frame.wrench) and repr(press.loads).startswith("<SimulatedLoads")


def test_the_simulated_part_sticks_and_slips(pressed: tuple[gs.Frame, gs.SimulatedFrame]) -> None:
    """It slips at its border and sticks in its middle; outside, the gel is free."""
    loads = pressed[1].loads
    assert loads is not None
    slips, stuck = loads.stick == gs.Stick.SLIPS, loads.stick == gs.Stick.STUCK
    assert slips.sum() > 3 and stuck.sum() > 3
    points = pressed[1].points_mm[:, :2]
    middle = points[stuck].mean(axis=0)
    assert (
        np.linalg.norm(points[stuck] - middle, axis=1).mean()
        < np.linalg.norm(points[slips] - middle, axis=1).mean()
    )


def test_the_work_of_a_frame_includes_its_force(sensor: gs.Simulator) -> None:
    """Predicted from the contact of the frame before: some ten million instructions for a ball."""
    pose = np.eye(4)
    pose[:3, 3] = 4.0, 0.0, 40.0
    force = {"method": "ridge", "thickness_mm": 5.0, "young_kpa": 100.0}
    pipeline = gs.Pipeline(sensor.scene.rig, gs.Params.preset("fast").replace(force=force))
    held = sensor.press(sensor.pressed(pose, 0.7))
    frames = [
        pipeline.process(pair.left, pair.right) for pair in (sensor[0], sensor[0], held, held, sensor[0])
    ]
    none, without, first, second, after = (frame.work for frame in frames)
    assert none and without == first < second and 1_000 < second - first < 50_000
    assert after > first, "predicted before it was seen"


def test_without_a_method_there_is_no_force(sensor: gs.Simulator) -> None:
    frame = gs.Pipeline(sensor.scene.rig).process(sensor[0].left, sensor[0].right)
    assert frame.wrench is None and frame.traction_kpa.shape == (0, 3)
    assert sensor[0].loads is None, "the shape of the gel is not that of an elastic layer"


def test_what_is_missing_is_named() -> None:
    with pytest.raises(gs.ParamsError, match=r'force.method = "bounded" requires force.thickness_mm'):
        gs.Params().replace(force={"method": "bounded"})
    with pytest.raises(gs.ParamsError, match=r"force\.poisson_ratio is 0\.6; valid is 0 to 0\.5"):
        gs.Params().replace(force={"poisson_ratio": 0.6})
    rest, nothing = lattice(), np.zeros((ROWS**2, 3, 3))
    with pytest.raises(gs.ContactError, match="square lattice"):
        estimator(rest * [1.3, 1.0, 1.0], 4.0, 0.48)
    with pytest.raises(gs.ContactError, match="288 entries"):
        estimator(rest, 4.0, 0.48).run(rest, nothing, [False] * (ROWS**2 - 1))


def test_a_resultant_is_a_sum_over_the_markers() -> None:
    """Independently: each marker is a spring, and noise acts through the same sum."""
    random = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(12) * 0.9, np.arange(10) * 0.9)
    rest = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)])
    patch = np.hypot(rest[:, 0] - 5.0, rest[:, 1] - 4.0) < 1.6
    stiffness = {"patch_n_per_mm3": 0.03, "around_n_per_mm3": 0.05, "shear_n_per_mm3": 0.01}
    force = {"method": "resultant", "thickness_mm": 100.0, "resultant_sigma": 0.0, **stiffness}
    params = gs.Params().replace(force=force)
    estimator = gs.ForceEstimator(
        gs.RestSurface(rest), params, cols=12, covariance_mm2=np.zeros((len(rest), 3, 3))
    )
    motion = 0.1 * random.normal(size=rest.shape)
    root = 0.002 * random.normal(size=(len(rest), 3, 3))
    covariance = root @ root.transpose(0, 2, 1) + 1e-8 * np.eye(3)
    traction, wrench = estimator.run(rest + motion, covariance, patch.tolist())
    assert wrench is not None and wrench.markers == len(rest)
    springs = 0.81 * np.where(patch[:, None], [0.01, 0.01, 0.08], [0.01, 0.01, 0.05])
    arms = rest - rest.mean(axis=0)
    forces = springs * motion
    np.testing.assert_allclose(wrench.force_n, forces.sum(axis=0), atol=1e-12)
    # The pressing force acts at the middle of the heights under the part.
    heights = np.where(patch, np.maximum(-motion[:, 2], 0.0), 0.0)
    centre = heights @ arms / heights.sum()
    torque = np.cross(centre, forces.sum(axis=0) * [0, 0, 1]) + np.cross(arms, forces * [1, 1, 0]).sum(axis=0)
    np.testing.assert_allclose(wrench.torque_nmm, torque, atol=1e-11)
    # Of the noise, a part of 0.02 of the pressing force along the gel, and 0.2 of the radius of the pressure.
    expected = np.zeros((6, 6))
    for arm, spring, each in zip(arms, springs, covariance, strict=True):
        lever, middle = (np.cross(np.eye(3), -at).T for at in (arm, centre))
        jacobian = np.vstack(
            [np.diag(spring), lever @ np.diag(spring * [1, 1, 0]) + middle @ np.diag(spring * [0, 0, 1])]
        )
        expected += jacobian @ each @ jacobian.T
    pressing, pulling = abs(wrench.force_n[2]), np.hypot(*wrench.force_n[:2])
    radius = np.sqrt(heights @ np.sum((arms - centre) ** 2, axis=1) / heights.sum() + 0.81 / 6.0)
    for axis in np.eye(3)[:2]:
        aside = 0.02 * pressing * np.concatenate([axis, np.cross(centre, axis)])
        off = 0.2 * radius * pressing * np.concatenate([np.zeros(3), axis])
        expected += np.outer(aside, aside) + np.outer(off, off)
    expected[5, 5] += (0.2 * radius * pulling) ** 2
    np.testing.assert_allclose(wrench.covariance, expected, atol=1e-11)
    # The tractions have the force, and only under the part.
    np.testing.assert_allclose(0.81e-3 * traction.sum(axis=0), wrench.force_n, atol=1e-9)
    assert not traction[~patch].any()
    # A share of the loads is added, of pressing and of pulling apart.
    wide = gs.ForceEstimator(
        gs.RestSurface(rest),
        params.replace(force={"resultant_sigma": 0.2}),
        cols=12,
        covariance_mm2=np.zeros((len(rest), 3, 3)),
    )
    _, wider = wide.run(rest + motion, covariance, patch.tolist())
    assert wider is not None
    added = np.diag(wider.covariance - wrench.covariance)[:3]
    np.testing.assert_allclose(added, (0.2 * wrench.force_n) ** 2, atol=1e-9)
    # A single marker leaves no direction of the covariance without a width.
    _, single = estimator.run(rest + motion, covariance, [k == 50 for k in range(len(rest))])
    assert single is not None and np.linalg.eigvalsh(single.covariance)[0] > 0.0
    # Markers that are not seen move like the others of their kind.
    lost = rest + 0.1
    lost[np.flatnonzero(patch)[:2]] = np.nan
    lost[np.flatnonzero(~patch)[:5]] = np.nan
    _, found = estimator.run(lost, covariance, patch.tolist())
    _, whole = estimator.run(rest + 0.1, covariance, patch.tolist())
    assert found is not None and whole is not None
    np.testing.assert_allclose(found.force_n, whole.force_n, rtol=1e-12)
    with pytest.raises(gs.ParamsError, match=r"requires force\.shear_n_per_mm3"):
        gs.Params().replace(force={**force, "shear_n_per_mm3": None})
