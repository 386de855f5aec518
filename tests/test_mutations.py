"""The faults that the tests must find still fit the source."""

from __future__ import annotations

from pathlib import Path

import pytest

from gelstereo_bench.mutations.mutant import Mutant, mutants

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("mutant", mutants(), ids=lambda mutant: mutant.name)
def test_mutants_fit_the_source(mutant: Mutant) -> None:
    text = (REPOSITORY / mutant.file).read_text(encoding="utf-8")
    switched = mutant.switched(7, text)
    assert mutant.old in switched and mutant.new in switched


def test_names_are_unique() -> None:
    names = [mutant.name for mutant in mutants()]
    assert len({*names}) == len(names)


def test_an_ambiguous_text_is_refused() -> None:
    mutant = Mutant("twice", "crates/a/src/lib.rs", "a + b", "a - b", "sign", [])
    for text in ("nothing", "a + b; a + b"):
        with pytest.raises(ValueError, match="mutant twice"):
            mutant.switched(0, text)
