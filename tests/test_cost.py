"""The cost model: a fit recovers what the samples were made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gelstereo_bench.frontier import cost
from gelstereo_bench.frontier.cost import Sample, fit_costs, rust_lines, time_table
from gelstereo_bench.frontier.cost_registration import (
    RegistrationSample,
    fit_registration,
    registration_table,
    thinned,
)
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, grasps


def samples(seed: int, ms_per_unit: float, ms_per_slow: float) -> list[Sample]:
    """Every variant on every size, with random coefficients; slow terms have another time."""
    random = np.random.default_rng(seed)
    out = []
    coefficients: dict[tuple[str, int], float] = {}
    for size, lattice in cost._SIZES:
        width, height = size.size_px
        area_px2 = float(0.2 * width * height / lattice**2 * random.uniform(0.1, 0.3))
        for variant in cost._variants():
            columns = [
                (term, part)
                for term in variant.terms
                for part in range(len(cost.PARTS))
                if cost._SHAPES[term][part]
            ]
            for column in columns:
                coefficients.setdefault(column, random.uniform(1.0, 20.0))
            sample = Sample(size, lattice, variant, width * height, lattice**2, area_px2, 0.0, 0.0)
            units = sample.row(columns) * [coefficients[column] for column in columns]
            ms = [ms_per_slow if term in cost.SLOW_TERMS else ms_per_unit for term, _ in columns]
            out.append(
                replace(sample, instructions=float(sum(units)) * cost.UNIT, median_ms=float(units @ ms))
            )
    return out


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-5, 1e-2), st.floats(0.5, 4.0))
def test_the_fit_predicts_what_it_was_fitted_to(seed: int, ms_per_unit: float, slower: float) -> None:
    made = samples(seed, ms_per_unit, slower * ms_per_unit)
    fitted = fit_costs(made)
    assert np.allclose(fitted.ratios, 1.0, atol=1e-6)
    cells = [cell for row in time_table(made, fitted).rows for cell in row[1:]]
    assert all(cell.endswith(("(+0%)", "(-0%)")) for cell in cells), cells


def test_the_constants_of_the_core_are_those_of_the_fit() -> None:
    """Every term that the fit writes is a constant of `pipeline/work.rs`, and the other way round."""
    import re
    from pathlib import Path

    source = Path(__file__).parents[1] / "crates/gelstereo-core/src/pipeline/work.rs"
    in_core = set(re.findall(r"const (\w+): Cost = ", source.read_text(encoding="utf-8")))
    assert in_core == set(re.findall(r"const (\w+): Cost", rust_lines(fit_costs(samples(1, 1e-3, 1e-3)))))


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
