"""Writes what was measured into docs/constants.md."""

from __future__ import annotations

import re
from pathlib import Path

from gelstereo_bench.sensitivity.figures import change, kind_of
from gelstereo_bench.sensitivity.results import Entry, Result

__all__ = ["listed", "stated", "write"]

_ROW = re.compile(r"^\| `([^`:]+: \w+)` \|")
#: In the order in which the page tells them.
_ORDER = ("0.5", "0.8", "1.25", "2")


def listed(path: Path) -> list[tuple[str, str]]:
    """File and name of every constant of the page."""
    found = [_ROW.match(line) for line in path.read_text(encoding="utf-8").splitlines()]
    keys = [row[1].partition(": ") for row in found if row]
    return [(file, name) for file, _, name in keys]


def write(path: Path, entries: dict[str, Entry], kept: set[str] | None = None) -> None:
    """Fill the last column of every row that has an entry; drop rows that are not kept."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        row = _ROW.match(line)
        if row and kept is not None and row[1] not in kept:
            continue
        if row:
            cells = line.strip().strip("|").split(" | ")
            entry = entries.get(row[1])
            cells[-1] = stated(entry) if entry else "not swept yet"
            line = "|" + " | ".join(cells) + " |"
        lines.append(line)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def stated(entry: Entry) -> str:
    """What an entry says, in a cell."""
    if entry.reason:
        return f"not swept: {entry.reason}"
    if not entry.read:
        return "no case reads it"
    if not any(result.differs for result in entry.results.values()):
        return "0.5 to 2 times: no result changes"
    texts = {factor: _result(entry.results[factor]) for factor in _ORDER if factor in entry.results}
    parts: list[tuple[list[str], str]] = []
    for factor, text in texts.items():
        if parts and parts[-1][1] == text:
            parts[-1][0].append(factor)
        else:
            parts.append(([factor], text))
    return "; ".join(f"{_range(factors)} times: {text}" for factors, text in parts)


def _range(factors: list[str]) -> str:
    if len(factors) == 1:
        return factors[0]
    # Nothing lies between 0.8 and 1.25 but the default.
    apart = len(factors) == 2 and set(factors) != {"0.8", "1.25"}
    return f"{factors[0]} {'and' if apart else 'to'} {factors[-1]}"


def _result(result: Result) -> str:
    if result.failed:
        return result.failed
    told = [each for each in result.figures if change(*each) >= 1.0]
    return _figure(*told[0]) if told else "no figure changes"


def _figure(name: str, default: float, found: float) -> str:
    """`centre error 0.031 to 0.045 px (exact, path-traced)`."""
    where, _, what = name.rpartition(": ")
    what, _, unit = what.partition(", ")
    digits = 3 if kind_of(name) in ("error", "ratio") else 4
    numbers = f"{default:.{digits}g} to {found:.{digits}g}{' ' + unit if unit else ''}".replace("um", "µm")
    return f"{what} {numbers}" + (f" ({where})" if where else "")
