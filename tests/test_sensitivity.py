"""The sweep of constants reads Rust as the compiler does, and says what it measured."""

from __future__ import annotations

from pathlib import Path

from gelstereo_bench.sensitivity import page, results
from gelstereo_bench.sensitivity.figures import change
from gelstereo_bench.sensitivity.results import Entry, Result
from gelstereo_bench.sensitivity.source import sources

RUST = """\
use super::other::{SHARE, Thing};
/// Not `WIDTH`; "WIDTH" neither.
pub(super) const WIDTH: [f64; 2] = [
    1.0, // WIDTH
    2.0,
];
const COUNT: usize = 3;
fn first<const N: usize>(text: &str) -> f64 {
    let text = "WIDTH µ";
    WIDTH[0] * SHARE + f64::MAX
}
#[cfg(test)]
mod tests {
    const COUNT: usize = 4;
}
"""


def test_constants_and_their_uses_are_found(tmp_path: Path) -> None:
    (tmp_path / "file.rs").write_text(RUST, encoding="utf-8")
    source = sources(tmp_path)["file.rs"]
    found = {each.name: source.value(each) for each in source.definitions}
    assert found == {"WIDTH": "[ 1.0, 2.0, ]", "COUNT": "3"}
    assert {name for _, name in source.names() if len(name) > 1} == {"WIDTH", "SHARE"}
    for at, name in source.names():
        assert source.text[at : at + len(name)] == name


def test_a_cell_tells_the_figure_that_changed_most() -> None:
    told = [("exact, simulated: centre error, px", 0.03, 0.04), ("names", 0.0, 3.0)]
    entry = Entry("1.0", read=["names"], results={"0.5": Result(16.7, True, told), "2": Result(0.1, True)})
    assert page.stated(entry) == (
        "0.5 times: centre error 0.03 to 0.04 px (exact, simulated); 2 times: no figure changes"
    )
    entry.results = {"0.5": Result(), "2": Result()}
    assert page.stated(entry) == "0.5 to 2 times: no result changes"
    assert page.stated(Entry("3")) == "no case reads it"
    assert page.stated(Entry("3", "fixes a size")) == "not swept: fixes a size"
    assert change("labelled, %", 99.0, 98.6) < 1.0 <= change("labelled, %", 99.0, 98.4)
    assert change("right poses, %", 90.0, 88.0, least=3.0) < 1.0


def test_results_follow_a_constant_that_moved(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    results.save(
        path, {key: Entry(value) for key, value in (("a.rs: X", "1"), ("a.rs: Y", "2"), ("a.rs: Z", "3"))}
    )
    kept = results.pruned(results.load(path), {"a.rs: X": "1", "b.rs: Y": "2", "b.rs: Z": "4"})
    assert {key: each.value for key, each in kept.items()} == {"a.rs: X": "1", "b.rs: Y": "2"}
