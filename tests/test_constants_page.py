"""The page of picked constants states the values of the source."""

from __future__ import annotations

import re
from pathlib import Path

from gelstereo_bench.sensitivity import results
from gelstereo_bench.sensitivity.page import stated
from gelstereo_bench.sensitivity.source import sources

REPOSITORY = Path(__file__).parents[1]
PAGE = REPOSITORY / "docs" / "constants.md"
CORE = REPOSITORY / "crates" / "gelstereo-core" / "src"
RESULTS = REPOSITORY / "bench" / "gelstereo_bench" / "sensitivity" / "results.json"
COLUMNS = [
    "file",
    "value",
    "what it decides",
    "chosen on",
    "reason in the source",
    "range tried and effect",
]
STAGES = [
    "detect",
    "lattice",
    "track",
    "triangulate",
    "contact",
    "force",
    "slip",
    "motion",
    "register",
    "pipeline",
]
CHOSEN_ON = {
    "simulated images",
    "simulated contacts",
    "path-traced images for work",
    "FEM gels",
    "real recordings",
    "not stated",
}
LEAST_ROWS = 80


def table() -> list[list[str]]:
    """Cells of the table, row by row, without the line below the header."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if not all(re.fullmatch(r":?-{3,}:?", cell) for cell in row)]


def rows() -> list[list[str]]:
    """Rows of constants, without the header and the rows that name a stage."""
    return [row for row in table()[1:] if row[0].startswith("`")]


def constants() -> list[tuple[str, str, str]]:
    """File, name and value of every constant of the table."""
    out = []
    for row in rows():
        places, values = (re.findall(r"`([^`]+)`", cell) for cell in row[:2])
        for place, value in zip(places, values, strict=True):
            file, _, name = place.partition(": ")
            out.append((file, name, value))
    return out


def values_in(source: str, name: str) -> list[str]:
    """Values of the constants with this name, with single spaces."""
    bare = re.sub(r"//[^\n]*", "", source)
    found = re.findall(rf"\bconst {name}\s*:[^=]*=(.*?);\s*$", bare, flags=re.DOTALL | re.MULTILINE)
    return [" ".join(value.split()) for value in found]


def test_the_table_is_complete_and_in_order() -> None:
    header, *body = table()
    assert header == COLUMNS
    assert {len(row) for row in body} == {len(COLUMNS)}
    assert [row[0].strip("*") for row in body if not row[0].startswith("`")] == STAGES
    assert len(rows()) >= LEAST_ROWS
    assert {row[3] for row in rows()} <= CHOSEN_ON
    assert [row[0] for row in rows() if len(row[2].split()) > 15] == []


def test_no_constant_is_listed_twice() -> None:
    names = [(file, name) for file, name, _ in constants()]
    assert len(set(names)) == len(names)


def test_values_are_those_of_the_source() -> None:
    missing = [file for file, _, _ in constants() if not (CORE / file).is_file()]
    assert missing == []
    wrong = []
    for file, name, value in constants():
        found = values_in((CORE / file).read_text(encoding="utf-8"), name)
        if " ".join(value.split()) not in found:
            wrong.append(f"{file}: {name} is {found}, not {value}")
    assert wrong == []


def test_every_constant_was_swept_with_the_value_that_it_has() -> None:
    """A new constant, or one with another value: `python -m gelstereo_bench.sensitivity`, then
    with `--page`.
    """
    entries, files = results.load(RESULTS), sources(CORE)
    told = {row[0].strip("`"): row[5] for row in rows()}
    wrong = []
    for file, name, value in constants():
        key = results.key_of(file, name)
        entry = entries.get(key)
        if entry is None:
            wrong.append(f"{key} was never swept")
        elif entry.value != " ".join(value.split()):
            wrong.append(f"{key} was swept as {entry.value}, and is {value}")
        elif told[key] != stated(entry):
            wrong.append(f"{key}: the page does not say what was measured")
        elif not (entry.reason or {"0.5", "2"} <= set(entry.results) or not entry.read):
            wrong.append(f"{key} has no range, and no reason")
    assert wrong == []
    assert sorted(set(entries) - set(told)) == []
    # What the tool reads of the source is what this file reads of it.
    for file, name, value in constants():
        found = [files[file].value(each) for each in files[file].definitions if each.name == name]
        assert " ".join(value.split()) in found, (file, name)


def test_the_factors_were_applied() -> None:
    """Constants that cannot be without effect: half of them, or twice, changes a figure."""
    entries = results.load(RESULTS)
    moved = {
        key for key, entry in entries.items() if any(each.most >= 1.0 for each in entry.results.values())
    }
    for stage in STAGES:
        assert any(key.startswith(f"{stage}/") for key in moved), stage
    swept = [entry for entry in entries.values() if entry.results]
    assert len(swept) >= 0.8 * len(entries)
