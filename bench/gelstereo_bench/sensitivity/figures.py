"""Figures of one evaluation, and how much two of them differ."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

__all__ = ["NOTED", "Case", "Evaluation", "Kind", "change", "kind_of"]

Kind = Literal["share", "contact", "count", "strays", "error", "ratio"]

#: By kind: the least change that a page tells. Shares and contact's F1 are in points of a per cent, counts
#: are as they are, errors and ratios are shares of the value.
NOTED: dict[Kind, float] = {
    "share": 0.5,
    "contact": 1.0,
    "count": 1.0,
    "strays": 5.0,
    "error": 0.02,
    "ratio": 0.05,
}
#: The same for methods whose steps turn on small differences. Another order of the markers, which should
#: change nothing, changes the shares of `surface_search` by up to 10 points, and its errors by up to 19 %.
_COARSE: dict[str, dict[Kind, float]] = {
    "surface_search": {"share": 11.0, "ratio": 0.2},
    "surface_close": {"share": 5.0, "ratio": 0.1},
}
#: By a word in the name, points: two registrations more or less are chance.
_CHANCE = {"right poses": 6.0, "believed": 10.0}
_KINDS: tuple[tuple[str, Kind], ...] = (
    ("F1, %", "contact"),
    ("%", "share"),
    ("strays", "strays"),
    ("NEES", "ratio"),
    ("bound", "ratio"),
    ("um", "error"),
    ("px", "error"),
    ("degrees", "error"),
)


def kind_of(name: str) -> Kind:
    """The kind of a figure, by the end of its name."""
    return next((kind for end, kind in _KINDS if name.endswith(end)), "count")


def change(name: str, default: float, other: float, least: float = 0.0) -> float:
    """Change over the smallest one worth reporting. `least` is the smallest that the sample can resolve."""
    if np.isnan(default) or np.isnan(other):
        # Nothing was found to take it of: other figures say so.
        return 0.0
    kind = kind_of(name)
    scale = max(abs(default), 1e-12) if kind in ("error", "ratio") else 1.0
    coarse = _COARSE.get(name.partition(",")[0], {})
    chance = [points for words, points in _CHANCE.items() if words in name]
    noted = chance[0] if chance else coarse.get(kind, NOTED[kind])
    return abs(other - default) / max(noted * scale, least)


@dataclass
class Evaluation:
    """Figures by name, and a digest of every number that was found."""

    figures: dict[str, float] = field(default_factory=dict)
    #: The least change of a figure that its sample resolves.
    least: dict[str, float] = field(default_factory=dict)
    _hash: hashlib._Hash = field(default_factory=hashlib.sha256)

    def put(self, name: str, figure: float, least: float = 0.0) -> None:
        """Add a figure."""
        self.figures[name] = figure
        if least > 0.0:
            self.least[name] = least

    def see(self, *values: npt.ArrayLike) -> None:
        """Put results into the digest."""
        for value in values:
            self._hash.update(np.ascontiguousarray(value).tobytes())

    @property
    def digest(self) -> str:
        """Of all results so far."""
        return self._hash.hexdigest()[:16]


@dataclass(frozen=True)
class Case:
    """Data with truth, loaded."""

    evaluate: Callable[[], Evaluation]
    #: What takes long and is seldom affected: done anew for the constants that it reads.
    prepare: Callable[[], None] = lambda: None
