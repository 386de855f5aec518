"""Measured sensitivities, on file: by constant, with the value that it had."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

__all__ = ["FACTORS", "Entry", "Result", "key_of", "load", "pruned", "save"]

#: What every constant is multiplied by. Inner ones are tried where an outer one changes a figure.
FACTORS = (0.5, 2.0, 0.8, 1.25)
_HEAD = "What a constant times a factor changes; `python -m gelstereo_bench.sensitivity` writes this file."


@dataclass
class Result:
    """With one factor: the largest change, in what is noted, and the figures that change most."""

    most: float = 0.0
    #: Whether any result differs at all.
    differs: bool = False
    #: Name, default and what it became.
    figures: list[tuple[str, float, float]] = field(default_factory=list)
    #: What happened instead of a result.
    failed: str = ""


@dataclass
class Entry:
    """One constant."""

    value: str
    #: Why it was not swept.
    reason: str = ""
    #: Cases that read it.
    read: list[str] = field(default_factory=list)
    results: dict[str, Result] = field(default_factory=dict)


def key_of(file: str, name: str) -> str:
    """As the page of constants has it."""
    return f"{file}: {name}"


def load(path: Path) -> dict[str, Entry]:
    """All entries; none without a file."""
    if not path.exists():
        return {}
    stored = json.loads(path.read_text(encoding="utf-8"))["constants"]
    return {
        key: Entry(
            each["value"],
            each.get("reason", ""),
            each.get("read", []),
            {factor: Result(**result) for factor, result in each.get("results", {}).items()},
        )
        for key, each in stored.items()
    }


def save(path: Path, entries: dict[str, Entry]) -> None:
    """One line for each constant, in order."""
    lines = []
    for key in sorted(entries):
        entry = {name: value for name, value in asdict(entries[key]).items() if value}
        for result in entry.get("results", {}).values():
            for name in [name for name, value in result.items() if not value]:
                del result[name]
        lines.append(f"{json.dumps(key)}: {json.dumps(entry)}")
    text = f'{{"about": {json.dumps(_HEAD)},\n"constants": {{\n' + ",\n".join(lines) + "\n}}\n"
    waiting = path.with_suffix(".new")
    waiting.write_text(text, encoding="utf-8")
    waiting.replace(path)


def pruned(entries: dict[str, Entry], values: dict[str, str]) -> dict[str, Entry]:
    """Without constants that are gone; one that moved to another file with name and value takes its entry
    along.
    """
    kept = {key: entry for key, entry in entries.items() if key in values}
    for key, entry in entries.items():
        if key in values:
            continue
        name = key.partition(": ")[2]
        moved = [
            other
            for other, value in values.items()
            if other.partition(": ")[2] == name and value == entry.value and other not in kept
        ]
        if len(moved) == 1:
            kept[moved[0]] = entry
    return kept
