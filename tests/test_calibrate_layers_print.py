"""Calibration of the layers from prints with errors, and what it doubts; hard case 45.

Pixels are traced by `outside.optics`: Snell's law in NumPy, without the library's rays or its simulator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from gelstereo import Params, Pipeline, Rig, triangulate
from gelstereo.calibrate.bundle import Linearised
from gelstereo.calibrate.doubts import chi2_quantile
from gelstereo.calibrate.layers import LayersCalibration, SeatedFrame, calibrate_layers
from gelstereo.calibrate.print_error import print_variance
from outside.images import Condition, Sequence
from outside.optics import Camera, Optics, turned

COUNT, REACH, PITCH_MM, SIGMA_PX = 25, 6, 0.85, 0.03
PRIORS = {"plate_0_thickness_mm": 0.05, "plate_0_index": 0.005}
DESIGN = {
    "normal": [0.0, 0.0, 1.0],
    "gap_mm": 20.3,
    "plates": [{"thickness_mm": 3.0, "index": 1.49}],
    "gel_index": 1.42,
}
ROW, COL = np.divmod(np.arange(COUNT * COUNT), COUNT)
UNDER = (abs(ROW - COUNT // 2) <= REACH) & (abs(COL - COUNT // 2) <= REACH)
Array = np.ndarray


@dataclass(frozen=True)
class Made:
    """A sensor of known layers, and what it was calibrated with."""

    optics: Optics
    frames: list[SeatedFrame]
    found: LayersCalibration

    def off(self) -> Array:
        """Errors of the parameters."""
        optics = self.optics
        x, y, z = optics.left.rotation.T @ [0.0, 0.0, 1.0]
        true = [x / z, y / z, optics.gap_mm, optics.gel_index, optics.plate_mm, optics.plate_index]
        assert list(self.found.values)[3] == "gel_index" and list(self.found.values)[4:] == list(PRIORS)
        return np.array(list(self.found.values.values())) - true

    def bias_mm(self, height_mm: float = 1.8) -> float:
        """Error of the mean height of a board, seen without noise on a perfect print."""
        flat = PITCH_MM * np.column_stack([COL - COUNT // 2, ROW - COUNT // 2]) + [4.0, 0.0]
        rays = Params().replace({"triangulate.method": "rays"})

        def seen(places: Array, height_mm: float) -> Array:
            points = np.column_stack([places, np.full(len(places), self.optics.surface_mm - height_mm)])
            return np.asarray(triangulate(self.found.rig, *self.optics.project(points), rays))

        rest, raised = seen(flat, 0.0), seen(flat[UNDER], height_mm)
        centre = rest.mean(axis=0)
        normal = np.linalg.svd(rest - centre)[2][2]
        return float(((raised - centre) @ normal).mean() * -np.sign(normal[2])) - height_mm


def sensor(rng: np.random.Generator) -> Optics:
    """Cameras that lean by up to a degree, a gel of 2 to 5 mm, and layers off from the design."""
    left, right = (
        Camera(turned(*rng.uniform(-1.0, 1.0, 3)), centre, tuple(rng.uniform(-4.0, 4.0, 2) + [320.0, 240.0]))
        for centre in (np.zeros(3), np.array([8.0, 0.05, -0.03]))
    )
    return Optics(
        rng.uniform(2.0, 5.0),
        gap_mm=20.0 + rng.uniform(-0.3, 0.3),
        plate_mm=rng.normal(3.0, 0.05),
        plate_index=rng.normal(1.49, 0.005),
        gel_index=1.41 + rng.uniform(-0.01, 0.01),
        left=left,
        right=right,
    )


def make(
    seed: int,
    *,
    print_sigma_mm: float = 0.008,
    shape: Callable[[Array], Array] = lambda places: places,
    noise_px: float = SIGMA_PX,
    board_off_mm: float = 0.0,
    cameras: Callable[[str], str] = lambda toml: toml,
    **options: Any,
) -> Made:
    """Two frames at rest and two on boards, which drag markers along by 50 um; `shape` changes the print."""
    rng = np.random.default_rng([45, seed])
    optics = sensor(rng)
    places = shape(PITCH_MM * np.column_stack([COL - COUNT // 2, ROW - COUNT // 2]))
    places = places + rng.normal(0.0, print_sigma_mm, places.shape) + [4.0, 0.0]
    frames = []
    for height_mm in (0.0, 0.0, 0.8, 1.8):
        use, there, height = np.full(len(places), True), places, 0.0
        if height_mm > 0.0:
            use, there = UNDER, places + rng.normal(0.0, 0.05, places.shape)
            height = height_mm + rng.normal(0.0, 0.002) + (board_off_mm if height_mm < 1.0 else 0.0)
        points = np.column_stack([there, np.full(len(there), optics.surface_mm - height)])
        left, right = optics.project(points[use])
        left, right = (side + rng.normal(0.0, noise_px, side.shape) for side in (left, right))
        frames.append(SeatedFrame(height_mm, ROW[use], COL[use], left, right))
    known = {"pitch_mm": PITCH_MM, "priors": PRIORS, "sigma_px": SIGMA_PX, **options}
    rig = Rig.from_toml(cameras(optics.rig_toml()))
    return Made(optics, frames, calibrate_layers(rig, frames, layers=DESIGN, **known))


@pytest.fixture(scope="module")
def made() -> list[Made]:
    return [make(seed) for seed in range(16)]


def test_row_45_errors_of_the_print_are_in_the_uncertainty(made: list[Made]) -> None:
    off = np.array([m.off() / list(m.found.sigma.values()) for m in made])
    squares = [m.off() @ np.linalg.solve(m.found.covariance, m.off()) for m in made]
    # 96 normal numbers: one in 160 such sets has one beyond 4 sigma.
    assert np.abs(off).max() < 4.0
    low, high = stats.chi2.ppf([0.005, 0.995], off.size)
    assert low < sum(squares) < high
    assert all(not m.found.doubts for m in made)
    for m in made:
        # Of 1250 numbers: 2 % a standard deviation.
        assert m.found.print_sigma_mm == pytest.approx(0.008, rel=0.08)
        assert abs(m.found.pitch_mm - PITCH_MM) < 4.0 * m.found.pitch_sigma_mm
        # Worth having: a milliradian, and 0.002 for the index.
        assert max(m.found.sigma["tilt_x"], m.found.sigma["tilt_y"]) < 1e-3
        assert m.found.sigma["gel_index"] < 0.002


def test_row_45_heights_through_the_layers_found_have_no_bias(made: list[Made]) -> None:
    bias_um = np.array([1e3 * m.bias_mm() for m in made])
    assert abs(bias_um.mean()) < 4.0 / 3.0 and np.sqrt((bias_um**2).mean()) < 4.0


@pytest.mark.parametrize("pitch_mm", [0.8, 0.9])
def test_row_45_a_wrong_pitch_is_found_and_doubted(pitch_mm: float) -> None:
    m = make(3, pitch_mm=pitch_mm)
    assert [d.kind for d in m.found.doubts] == ["pitch"]
    assert m.found.pitch_mm == pytest.approx(PITCH_MM, abs=4e-4)
    assert np.abs(m.off() / list(m.found.sigma.values())).max() < 4.0
    assert "pitch" in m.found.summary() and abs(m.bias_mm()) < 6e-3


def stretched(places: Array) -> Array:
    return places * [1.002, 1.0]


def arched(places: Array) -> Array:
    """Columns that lie up to 20 um too far out."""
    return places + np.column_stack([0.0002 * places[:, 0] ** 2, 0.0 * places[:, 0]])


def misplaced(places: Array) -> Array:
    return places + np.where((ROW == 5) & (COL == 7), PITCH_MM, 0.0)[:, None] * [1.0, 0.0]


def swapped(places: Array) -> Array:
    """Every twentieth marker has its neighbour's name."""
    index = np.arange(len(places))
    first = index[(COL % 5 == 1) & (ROW % 4 == 2)]
    index[first], index[first + 1] = first + 1, first
    return places[index]


def distorted(toml: str) -> str:
    """Lenses that were calibrated wrong by 1.4 px at the sides of the image; a tenth of it goes
    into the gap.
    """
    return toml.replace("distortion = [0.0,", "distortion = [0.01,")


@pytest.mark.parametrize(
    ("change", "kinds"),
    [
        ({"noise_px": 0.06}, {"misfit"}),
        ({"shape": stretched}, {"misfit"}),
        ({"shape": arched}, {"misfit"}),
        ({"shape": misplaced}, {"print"}),
        ({"shape": swapped}, {"print"}),
        ({"cameras": distorted}, {"prior"}),
        ({"board_off_mm": 0.05}, {"prior"}),
        ({"priors": {**PRIORS, "gap_mm": 0.02}}, {"prior"}),
    ],
)
def test_row_45_what_the_model_lacks_is_doubted(change: dict[str, Any], kinds: set[str]) -> None:
    assert {d.kind for d in make(4, **change).found.doubts} >= kinds


def test_the_marker_that_stands_out_is_named() -> None:
    [doubt] = make(4, shape=misplaced).found.doubts
    assert doubt.kind == "print" and "row 5, column 7" in doubt.message


def test_noise_above_the_one_stated_widens_the_uncertainty() -> None:
    plain, noisy = (make(5, noise_px=noise_px).found for noise_px in (SIGMA_PX, 2.0 * SIGMA_PX))
    told = make(5, noise_px=2.0 * SIGMA_PX, sigma_px=2.0 * SIGMA_PX).found
    assert not plain.doubts and not told.doubts
    assert noisy.sigma["gel_index"] == pytest.approx(told.sigma["gel_index"], rel=0.1)
    # What the prior alone tells is no wider.
    assert noisy.sigma["plate_0_index"] < 1.05 * PRIORS["plate_0_index"]


@settings(max_examples=6)
@given(
    st.integers(100, 10**6),
    st.floats(0.0, 0.03),
    st.sampled_from([0.99, 0.999, 1.0, 1.001, 1.01]),
    st.floats(0.01, 0.1),
)
def test_any_print_and_noise(seed: int, print_sigma_mm: float, pitch: float, noise_px: float) -> None:
    m = make(
        seed,
        print_sigma_mm=print_sigma_mm,
        pitch_mm=pitch * PITCH_MM,
        noise_px=noise_px,
        sigma_px=noise_px,
    )
    # 36 normal numbers in all: one in 50 000 such sets has one beyond 5 sigma.
    assert np.abs(m.off() / list(m.found.sigma.values())).max() < 5.0
    assert not m.found.doubts
    # From 1250 numbers; a millimetre is 16 px or more, and two cameras in two frames halve the noise.
    noise_mm = noise_px / 16.0 / 2.0
    spread = 4.0 * (print_sigma_mm**2 + noise_mm**2) / (2.0 * 1250) ** 0.5
    assert abs(m.found.print_sigma_mm**2 - print_sigma_mm**2) < 2.0 * spread + 1e-12


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 12), st.floats(0.0, 0.5))
def test_the_prints_variance_is_that_of_restricted_likelihood(
    seed: int, parameters: int, true_mm: float
) -> None:
    """Dense covariances and SciPy's search, against the rotated and weighted sums."""
    rng = np.random.default_rng(seed)
    count = 30
    own, by = rng.normal(0.0, 10.0, (count, 4, 2)), rng.normal(size=(count, 4, parameters))
    residual = rng.normal(size=(count, 4)) + np.einsum(
        "mij,mj->mi", own, rng.normal(0.0, true_mm, (count, 2))
    )
    free = np.arange(count) >= 25
    prior, prior_by = rng.normal(size=1), np.eye(parameters)[:1]
    variances = np.where(free, np.inf, 0.01)
    at = Linearised(residual, by, own, variances, prior, prior_by)
    design, target = np.concatenate([by.reshape(-1, parameters), prior_by]), np.append(residual, prior)

    def restricted(variance: float) -> float:
        covariance = np.eye(len(target))
        for i in range(count):
            # Free is a variance that dwarfs all else.
            covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] += (
                (1e6 if free[i] else variance) * own[i] @ own[i].T
            )
        solved = np.linalg.solve(covariance, np.column_stack([design, target]))
        information, right = design.T @ solved[:, :-1], design.T @ solved[:, -1]
        left = target @ solved[:, -1] - right @ np.linalg.solve(information, right)
        return 0.5 * float(left + np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1])

    found = print_variance(at, 10.0)
    scipys = optimize.minimize_scalar(
        lambda log: restricted(float(np.exp(log))), bounds=(-18.0, 4.0), method="bounded"
    )
    assert restricted(found) <= scipys.fun + 1e-4


@given(st.integers(100, 10**6), st.floats(1e-5, 1.0 - 1e-5))
def test_quantiles_are_scipys(degrees: int, probability: float) -> None:
    """To a fiftieth of a standard deviation."""
    true = stats.chi2.ppf(probability, degrees)
    assert abs(chi2_quantile(degrees, probability) - true) < 0.02 * np.sqrt(2.0 * degrees)


@pytest.mark.parametrize("preset", ["exact", "balanced"])
def test_path_traced_images_tell_the_layers(preset: str) -> None:
    """A print off by 8 um at rest, and on the flat of a box 0.8 and 1.2 mm deep."""
    sequence = Sequence.load("w6_laws")
    true = Rig.from_toml(sequence.about["rig"])
    params = Params.preset(preset).replace({"lattice.pitch_mm": 0.8})
    pipeline = Pipeline(true.with_layers(DESIGN), params)
    rest, low, high = (pipeline.process(*sequence.pair(i, Condition())) for i in (0, 3, 4))
    frames = [SeatedFrame.from_frame(f, h) for f, h in ((rest, 0.0), (low, 0.8), (high, 1.2))]
    found = calibrate_layers(
        true,
        frames,
        layers=DESIGN,
        pitch_mm=0.8,
        priors=PRIORS,
        sigma_px=0.012 if preset == "exact" else 0.03,
    )
    assert not found.doubts
    (x, y, z), gap_mm = true.layers["normal"], true.layers["gap_mm"]
    off = np.array(list(found.values.values())) - [x / z, y / z, gap_mm, 1.41, 3.0, 1.49]
    assert np.abs(off / list(found.sigma.values())).max() < 3.0
    # As printed: a sample of 1250 numbers, and what detection adds.
    assert found.print_sigma_mm == pytest.approx(0.008, rel=0.1)
    assert found.pitch_mm == pytest.approx(0.8, abs=2e-4)
    # True pixels of other contacts through the layers found.
    rays = Params().replace({"triangulate.method": "rays"})
    for i in (2, 4, 6):
        left, right, points = (sequence.truth[key][i] for key in ("left_px", "right_px", "points_mm"))
        error = triangulate(found.rig, left, right, rays) - points
        assert np.sqrt((error**2).mean(axis=0)).max() < 6e-3


def test_order_of_frames_and_markers_does_not_matter() -> None:
    rng = np.random.default_rng(9)
    m = make(9)
    frames = []
    for f in m.frames[::-1]:
        at = rng.permutation(len(f.rows))
        frames.append(SeatedFrame(f.height_mm, f.rows[at], f.cols[at], f.left_px[at], f.right_px[at]))
    rig = Rig.from_toml(m.optics.rig_toml())
    again = calibrate_layers(rig, frames, layers=DESIGN, pitch_mm=PITCH_MM, priors=PRIORS, sigma_px=SIGMA_PX)
    off = np.array(list(again.values.values())) - list(m.found.values.values())
    assert np.abs(off / list(m.found.sigma.values())).max() < 1e-3
    assert again.print_sigma_mm == pytest.approx(m.found.print_sigma_mm, rel=1e-3)
    assert again.chi2 == pytest.approx(m.found.chi2, rel=1e-5)
