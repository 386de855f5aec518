"""The cost model: a fit recovers what the samples were made of."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo as gs
from gelstereo.tune.rungs import params_of
from gelstereo_bench.frontier import cost
from gelstereo_bench.frontier.cost import Sample, Timed, cost_table, fit_costs, rust_lines, time_table
from gelstereo_bench.frontier.cost_registration import (
    RegistrationSample,
    fit_registration,
    registration_table,
    thinned,
)
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, grasps
from gelstereo_bench.frontier.scenes import sphere_press

SOURCE = Path(__file__).parents[1] / "crates/gelstereo-core/src/pipeline/work.rs"


def core_constants() -> dict[str, float]:
    """Those of `pipeline/work.rs` that the fit writes."""
    found = re.findall(r"^const (\w+): f64 = ([\d._]+);", SOURCE.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: float(value) for name, value in found if not name.endswith("_PX")}


def samples(seed: int) -> tuple[list[Sample], dict[str, float]]:
    """Every variant on every size and in an image with reflections, with random constants."""
    random = np.random.default_rng(seed)
    constants = {name: random.uniform(1.0, 20.0) for name in core_constants()}
    out = []
    for size, lattice in [*cost._SIZES, (cost.FORMATS[0], 0)]:
        shown = {
            name: int(random.integers(3, 900)) for name in ("usual_px2", "noise_rows", "rows_beside_noise")
        }
        shown |= {"is_half_size": int(random.integers(2)), "fit_groups": int(random.integers(1, 17))}
        shown |= {"sums_pixels": int(random.integers(2)), "closed_px": 0 if lattice else 1_000_000}
        for variant in cost.variants():
            made = Sample(size, lattice, variant, lattice**2 or 625, shown, 0.0)
            units = sum(constants[name] * count for name, count in made.multiples.items())
            out.append(replace(made, instructions=cost.UNIT * units))
    return out, constants


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_the_fit_predicts_what_it_was_fitted_to(seed: int) -> None:
    made, constants = samples(seed)
    fitted = fit_costs(made)
    assert np.allclose(fitted.ratios, 1.0, atol=1e-6)
    assert fitted.constants.keys() == constants.keys()
    cells = [cell for row in cost_table(made, fitted).rows for cell in row[1:]]
    assert all("(+0%, " in cell or "(-0%, " in cell for cell in cells), cells


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-5, 1e-2), st.floats(0.5, 4.0))
def test_times_of_two_units_are_predicted_from_three(seed: int, ms_per_unit: float, slower: float) -> None:
    """Units of rays and disc bias take `slower` times as long."""
    random = np.random.default_rng(seed)
    timed = []
    for size, lattice in cost._SIZES:
        works = {variant.name: int(random.integers(1000, 100_000)) for variant in cost.variants()}
        for variant in cost.variants():
            slow = int(random.integers(500, 9000)) if "rays" in variant.name else 0
            usual = works["windows soft"] if slow else works[variant.name]
            time_ms = ms_per_unit * (usual + slower * slow)
            timed.append(Timed(size, lattice, variant, usual + slow, time_ms))
    cells = [cell for row in time_table(timed).rows for cell in row[1:]]
    assert all(cell.endswith(("(+0%)", "(-0%)")) for cell in cells), cells


@pytest.mark.parametrize("name", ["windows soft", "windows fit", "windows fine fit", "rays, disc bias"])
def test_the_core_predicts_the_work_of_the_model(name: str) -> None:
    """The model here and that of `pipeline/work.rs` are written twice. The size of a fit's window is unknown
    here.
    """
    (variant,) = (each for each in cost.variants() if each.name == name)
    params = params_of(()).replace(dict(variant.changes))
    size = cost.FORMATS[0]
    first, second = sphere_press(scene=size.scene())[:2]
    pipeline = gs.Pipeline(size.rig(), params)
    for frame in (first, second):
        found = pipeline.process(frame.left, frame.right)
    assert found.left.searched == "windows"
    detector = gs.Detector(params)
    usual_px2 = int(max(np.median(detector.detect(view).area_px2) for view in (first.left, first.right)))
    constants, predicted = core_constants(), []
    for groups in range(1, 17) if "fit" in name else (0,):
        shown = {"usual_px2": usual_px2, "fit_groups": groups, "sums_pixels": 0}
        multiples = Sample(size, 25, variant, 625, shown, 0.0).multiples
        predicted.append(sum(constants[term] * count for term, count in multiples.items()))
    # Each of three parts is rounded down.
    assert any(0.0 <= units - found.work < 4.0 for units in predicted), (found.work, predicted)


def test_the_constants_of_the_core_are_those_of_the_fit() -> None:
    """Every term that the fit writes is a constant of `pipeline/work.rs`, and the other way round."""
    lines = rust_lines(fit_costs(samples(1)[0]))
    assert set(re.findall(r"const (\w+): f64", lines)) == set(core_constants())


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(1e3, 1e7), min_size=4, max_size=4), st.integers(0, 1000))
def test_the_fit_of_registration_finds_its_coefficients(coefficients: list[float], seed: int) -> None:
    random = np.random.default_rng(seed)
    made = []
    for _ in range(30):
        faces, salient = int(2 ** random.uniform(4, 16)), random.uniform(5, 300)
        sample = RegistrationSample("m", "part", faces, salient, salient + random.uniform(0, 900), 0.0)
        made.append(replace(sample, instructions=float(sample.row @ coefficients)))
    found = fit_registration(made)
    assert all(np.isclose(sample.row @ found, sample.instructions, rtol=1e-6) for sample in made)
    assert registration_table(made).rows[0][-1] in ("+0 to +0", "-0 to +0", "-0 to -0")


def test_thinned_contacts_keep_a_share_of_salient_and_other_markers() -> None:
    one = next(grasps(GRASPED[1], NOISES[0], range(1, 2)))
    salient, others = thinned(one, 1.0, 3)
    assert len(salient) == len(one.points_mm) and len(salient) + len(others) == len(one.all_points_mm)
    half, _ = thinned(one, 0.5, 3)
    assert len(half) == round(0.5 * len(salient))
    assert {tuple(point) for point in half} < {tuple(point) for point in salient}
