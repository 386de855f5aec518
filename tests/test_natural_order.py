"""Names of images sort as `gelstereo-host` sorts them: numbers count as numbers."""

from __future__ import annotations

import random
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from gelstereo.cli.files import natural_key, stereo_pairs

# The Rust source is tested against the same list.
NAMES = (Path(__file__).parent / "natural_order.txt").read_text(encoding="utf-8").splitlines()


def test_names_are_in_the_order_that_the_host_has() -> None:
    shuffled = NAMES.copy()
    random.Random(1).shuffle(shuffled)
    assert sorted(shuffled, key=natural_key) == NAMES


@given(
    st.lists(st.tuples(st.text("abc_-", min_size=1, max_size=2), st.integers(0, 2000)), max_size=30),
    st.integers(0, 4),
)
def test_the_order_is_that_of_the_numbers(tuples: list[tuple[str, int]], zeros: int) -> None:
    names = [f"{text}{number:0{zeros}d}" if zeros else f"{text}{number}" for text, number in tuples]
    expected = [
        f"{text}{number:0{zeros}d}" if zeros else f"{text}{number}" for text, number in sorted(tuples)
    ]
    assert sorted(names, key=natural_key) == expected


def test_pairs_of_a_folder_come_in_natural_order(tmp_path: Path) -> None:
    for view in ("left", "right"):
        (tmp_path / view).mkdir()
        for number in (29, 3, 100):
            (tmp_path / view / f"{number}.png").touch()
    assert [left.name for left, _ in stereo_pairs(tmp_path)] == ["3.png", "29.png", "100.png"]
