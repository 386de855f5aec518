"""The elastic layer against other people's solvers: finite elements (scikit-fem) and boundary elements
(tamaas).
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import numpy.typing as npt
import pytest
import tamaas
from layer_reference import Disc
from scipy.interpolate import PchipInterpolator
from scipy.optimize import nnls
from scipy.stats import chi2

import gelstereo
from gelstereo.recordings import episodes, load_pytac3d, pytac3d_example
from gelstereo_bench.reports import physics
from gelstereo_bench.reports.recordings import SALIENCY_MM

Array = npt.NDArray[np.float64]


def cells(count: int, cell_mm: float) -> tuple[Array, Array]:
    """x and y of every cell, from the grid's middle."""
    along = (np.arange(count) - 0.5 * (count - 1)) * cell_mm
    return np.broadcast_to(along, (count, count)), np.broadcast_to(along[:, None], (count, count))


def covered(count: int, cell_mm: float, radius: float) -> Array:
    """Which share of every cell lies within a circle."""
    fine = 16
    x, y = cells(count * fine, cell_mm / fine)
    return (np.hypot(x, y) < radius).reshape(count, fine, count, fine).mean(axis=(1, 3))


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.48])
def test_loads_move_the_layer_as_finite_elements_do(poisson_ratio: float) -> None:
    """Within 1 % of the largest motion, component by component, from the disc's middle to four
    thicknesses.
    """
    count, cell, disc = 120, 0.05, Disc(poisson_ratio, radius=0.5)
    contact = gelstereo.LayerContact(
        thickness_mm=1.0, poisson_ratio=poisson_ratio, rows=count, cols=count, cell_mm=cell, friction=1.0
    )
    load, none = covered(count, cell, disc.radius), np.zeros((count, count))
    x, y = cells(count, cell)
    r, cosine, sine = np.hypot(x, y), x / np.hypot(x, y), y / np.hypot(x, y)
    # At the rim itself the motion's slope is infinite, and cells are covered in part.
    beside = np.abs(r - disc.radius) > 2 * cell

    def far_off(found: Array, expected: Array) -> float:
        return float(np.abs(found - expected)[beside].max())

    distances, amplitudes = disc.motion(mode=0)
    out, _, up = (PchipInterpolator(distances, amplitude)(r) for amplitude in amplitudes)
    motion = contact.load(load).motion_mm
    assert far_off(-motion[..., 2], up) < 0.01 * np.abs(up).max()
    # Sideways motion is a tenth of that, and right to 2 % of itself.
    aside = motion[..., 0] * cosine + motion[..., 1] * sine
    assert far_off(aside, out) < min(0.01 * np.abs(up).max(), 0.02 * np.abs(out).max())

    distances, amplitudes = disc.motion(mode=1)
    out, about, up = (PchipInterpolator(distances, amplitude)(r) for amplitude in amplitudes)
    motion = contact.load(none, np.stack((load, none), axis=-1)).motion_mm
    largest = np.abs(out).max()
    assert far_off(motion[..., 0], out * cosine**2 + about * sine**2) < 0.01 * largest
    assert far_off(motion[..., 1], (out - about) * cosine * sine) < 0.01 * largest
    assert far_off(-motion[..., 2], up * cosine) < 0.01 * largest


def test_a_rough_part_on_a_thick_layer_is_tamaas_within_1_percent() -> None:
    count, cell = 64, 0.05
    rng = np.random.default_rng(1)
    x, y = cells(count, cell)
    heights = 0.05 - (x**2 + y**2) / 16
    for _ in range(12):
        wave, phase = rng.uniform(-8, 8, 2), rng.uniform(0, 6.3)
        heights = heights + 0.002 * np.cos(wave[0] * x + wave[1] * y + phase)
    contact = gelstereo.LayerContact(
        thickness_mm=1000.0, poisson_ratio=0.3, rows=count, cols=count, cell_mm=cell
    )
    ours = contact.press(heights, tolerance_mm=1e-9)
    assert ours.converged

    model = tamaas.ModelFactory.createModel(tamaas.model_type.basic_2d, [count * cell] * 2, [count] * 2)
    model.E, model.nu = 1.0, 0.3
    tamaas.ModelFactory.registerNonPeriodic(model, "open")
    solver = tamaas.PolonskyKeerRey(model, np.ascontiguousarray(heights), 1e-12)
    solver.setIntegralOperator("open")
    solver.solve(ours.pressure.mean())
    theirs = np.asarray(model.traction).reshape(count, count)
    assert 50 < (theirs > 0).sum() < 2000
    assert np.abs(ours.pressure - theirs).max() < 0.01 * theirs.max()


def compliance(contact: gelstereo.LayerContact, count: int) -> Array:
    """Height of every cell under a unit pressure on every other, one load at a time."""
    units = np.eye(count**2).reshape(-1, count, count)
    return np.stack([contact.load(unit).motion_mm[..., 2].ravel() for unit in units], axis=1)


def l_curve(matrix: Array, heights: Array) -> Array:
    """Tikhonov's pressures at the corner of the L-curve: of log residual against log size, where it bends
    most.
    """
    u, s, v = np.linalg.svd(matrix)
    beta = u.T @ heights
    weights = np.geomspace(0.1 * s[-1], s[0], 60)[:, None]
    tried = beta * s / (s**2 + weights**2)
    x, y = (np.log(np.linalg.norm(part, axis=1)) for part in (beta - s * tried, tried))
    dx, dy = np.gradient(x), np.gradient(y)
    bend = (dx * np.gradient(dy) - dy * np.gradient(dx)) / np.hypot(dx, dy) ** 3
    return np.asarray(v.T @ tried[2 + np.argmax(bend[2:-2])])


@pytest.mark.parametrize("noise_mm", [0.001, 0.02, 0.1])
def test_row_29_force_from_markers_with_noise(noise_mm: float) -> None:
    """The pressures that explain measured heights without pulling add up to the load, as well as the noise
    allows.
    """
    count, cell, draws = 13, 0.9, 200
    contact = gelstereo.LayerContact(
        thickness_mm=5.0, poisson_ratio=0.48, rows=count, cols=count, cell_mm=cell
    )
    x, y = cells(count, cell)
    # Hertz's load under a ball.
    load = 0.5 * np.sqrt(np.maximum(0.0, 1.0 - (x**2 + y**2) / 3.6**2))
    touched = np.flatnonzero(load)
    force, true = load.sum() * cell**2, contact.load(load).motion_mm[..., 2].ravel()[touched]
    matrix = compliance(contact, count)[np.ix_(touched, touched)]
    root = np.linalg.cholesky(matrix)
    rng = np.random.default_rng(29)
    errors, lost = np.empty((2, draws))
    constrained = 0
    for k in range(draws):
        noise = rng.normal(0.0, noise_mm, len(touched))
        heights = np.full(count**2, -np.inf)
        heights[touched] = true + noise
        pressure = contact.press(heights.reshape(count, count)).pressure.ravel()[touched]
        # Least p'Cp/2 - p'h over p >= 0, by another solver; the force moves by what the heights' tolerance
        # moves it.
        expected, _ = nnls(root.T, np.linalg.solve(root, heights[touched]))
        slope = np.abs(np.linalg.solve(matrix, np.ones(len(touched)))).sum() * cell**2
        assert abs(pressure.sum() - expected.sum()) * cell**2 < 1e-6 * slope
        errors[k] = pressure.sum() * cell**2 - force
        lost[k] = l_curve(matrix, heights[touched]).sum() * cell**2 - force
        constrained += int((pressure == 0.0).any())
        # Projection on pressures that do not pull brings no two closer points apart (in the energy's metric).
        energy = noise @ np.linalg.solve(matrix, noise) * np.linalg.solve(matrix, np.ones(len(touched))).sum()
        assert abs(errors[k]) <= np.sqrt(energy) * cell**2 * (1.0 + 1e-6)
    assert np.square(errors).mean() <= np.square(lost).mean()
    if constrained == 0:
        # Then the estimate is linear, and 200 squares over their variance lie in their 99.9 % band.
        sigma = noise_mm * cell**2 * np.linalg.norm(np.linalg.solve(matrix, np.ones(len(touched))))
        low, high = chi2.ppf([0.0005, 0.9995], draws) / draws
        assert low < np.square(errors / sigma).mean() < high


def test_a_layer_refuses_what_is_none() -> None:
    valid = {"thickness_mm": 5.0, "poisson_ratio": 0.48, "rows": 8, "cols": 8, "cell_mm": 0.5}
    with pytest.raises(gelstereo.LayerError, match=r"poisson_ratio is 0\.6; valid is 0 to 0\.5"):
        gelstereo.LayerContact(**{**valid, "poisson_ratio": 0.6})
    contact = gelstereo.LayerContact(**valid)
    with pytest.raises(gelstereo.LayerError, match="64 cells"):
        contact.press(np.zeros((8, 7)))
    with pytest.raises(gelstereo.LayerError, match="64 cells"):
        contact.load(np.zeros((8, 8)), np.zeros((8, 7, 2)))
    with pytest.raises(gelstereo.ShapeError, match="odd"):
        contact.press(np.zeros((8, 8)), np.zeros(3))
    with pytest.raises(gelstereo.LayerError, match="heights_mm is NaN"):
        contact.press(np.full((8, 8), np.nan))


@pytest.mark.skipif(find_spec("PyTac3D") is None, reason="the wheel pytac3d is absent")
def test_a_recorded_gel_rises_between_two_layers() -> None:
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    for run in episodes(recording.indentation_mm(), SALIENCY_MM):
        frames = physics.presses(recording, run, every=10)
        if len(run) < 8:
            continue

        def rise(thickness_mm: float, frames: list[physics.Press] = frames) -> float:
            gel = physics.Gel(thickness_mm, 0.5)
            of = [physics.of_layer(press, gel, recording.pitch_mm) for press in frames]
            pairs = zip(of, frames, strict=True)
            return float(np.median([physics.beside(motion, press).rise_mm for motion, press in pairs]))

        recorded = np.median([physics.beside(press.motion_mm, press).rise_mm for press in frames])
        assert rise(14.0) < recorded < rise(6.0)
        # The deepest of the free markers of a membrane lie on the contact's rim, and none rises.
        assert physics.membrane(frames[0], 2.0, recording.pitch_mm).min() >= -1e-9
